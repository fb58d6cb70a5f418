"""Who may see the workbench: the one who has its token, from this machine's own address, from its own pages."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING
from urllib.parse import parse_qs, urlencode

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

HOST = "127.0.0.1"
NAMES = (HOST, "localhost")
TOKEN = "token"


@dataclass(frozen=True)
class Access:
    """What a request must carry.

    Attributes:
        port: that the workbench listens on.
        token: in its opened address, then in a cookie.
    """

    port: int
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32))

    @property
    def address(self) -> str:
        """The address to open."""
        return f"http://{HOST}:{self.port}/?{urlencode({TOKEN: self.token})}"

    @property
    def cookie(self) -> str:
        """The name of the cookie: another workbench on this machine has its own."""
        return f"odescope-{self.port}"

    def refusal(self, headers: Mapping[str, str], query: str) -> str:
        """Return why a request is refused; no text where it is not.

        Args:
            headers: of the request, their names in lower case.
            query: of its address.
        """
        hosts = [f"{name}:{self.port}" for name in NAMES]
        if headers.get("host") not in hosts:
            return "this page is served under its own address alone"
        if "origin" in headers and headers["origin"] not in [f"http://{host}" for host in hosts]:
            return "this page is asked for by another one"
        if not self._known(self._cookie_token(headers)) and not self._known(self.query_token(query)):
            return "open the address that odescope workbench has printed: it holds the token that is missing here"
        return ""

    def query_token(self, query: str) -> str:
        """Return the token in an address."""
        return parse_qs(query).get(TOKEN, [""])[0]

    def _cookie_token(self, headers: Mapping[str, str]) -> str:
        try:
            found = SimpleCookie(headers.get("cookie", "")).get(self.cookie)
        except CookieError:
            return ""
        return "" if found is None else found.value

    def _known(self, token: str) -> bool:
        return secrets.compare_digest(token.encode(), self.token.encode())


def page_policy(port: int) -> str:
    """Return what the pages may load: nothing from anywhere but the workbench; its scripts are compiled in place."""
    sockets = " ".join(f"ws://{name}:{port}" for name in NAMES)
    return (
        "default-src 'self'; script-src 'self' 'unsafe-inline' 'unsafe-eval'; style-src 'self' 'unsafe-inline';"
        f" img-src 'self' data: blob:; font-src 'self' data:; connect-src 'self' {sockets}; object-src 'none';"
        " base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


STORED_POLICY = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:"  # of a page from the folder


class Guard:
    """Stands before an application, for pages and websockets alike: asks `Access`, and sets the policy of pages."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self.app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request.

        Args:
            scope: what is asked for.
            receive: as ASGI has it.
            send: as ASGI has it.
        """
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        query = scope["query_string"].decode("latin-1")
        if reason := self._access.refusal(headers, query):
            await _refuse(scope, send, reason)
        elif scope["type"] == "http" and self._access.query_token(query):
            await self._let_in(scope, query, send)
        else:
            await self.app(scope, receive, self._with_policy(send))

    def _with_policy(self, send: Send) -> Send:
        async def sent(message: Message) -> None:
            if message["type"] == "http.response.start":
                names = {name.lower() for name, _ in message["headers"]}
                more = [(b"referrer-policy", b"no-referrer"), (b"x-content-type-options", b"nosniff")]
                if b"content-security-policy" not in names:
                    more.append((b"content-security-policy", page_policy(self._access.port).encode()))
                message = {**message, "headers": [*message["headers"], *more]}
            await send(message)

        return sent

    async def _let_in(self, scope: Scope, query: str, send: Send) -> None:
        """Put the token into a cookie, and lead to the same page without it: addresses are kept and shown."""
        rest = urlencode({name: values for name, values in parse_qs(query).items() if name != TOKEN}, doseq=True)
        path = "/" + scope["path"].lstrip("/")  # of two slashes a browser would make another host
        cookie = f"{self._access.cookie}={self._access.token}; HttpOnly; SameSite=Strict; Path=/"
        headers = [(b"location", (path + ("?" + rest if rest else "")).encode()), (b"set-cookie", cookie.encode())]
        await send({"type": "http.response.start", "status": 303, "headers": headers})
        await send({"type": "http.response.body", "body": b""})


async def _refuse(scope: Scope, send: Send, reason: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": reason})
        return
    headers = [(b"content-type", b"text/plain; charset=utf-8")]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": reason.encode()})
