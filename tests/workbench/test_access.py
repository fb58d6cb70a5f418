"""The guard of the workbench: token, cookie, host, origin, for pages and websockets."""

import asyncio

import pytest

pytest.importorskip("nicegui")

from odescope.workbench.access import Access, Guard

ACCESS = Access(8123, "right")
GOOD = {"host": "127.0.0.1:8123", "cookie": "odescope-8123=right"}


@pytest.mark.parametrize(
    ("headers", "query"),
    [
        (GOOD, ""),
        (GOOD | {"host": "localhost:8123", "origin": "http://localhost:8123"}, ""),
        ({"host": "127.0.0.1:8123"}, "token=right"),
        (GOOD | {"cookie": "a=b; odescope-8123=right; c=d"}, ""),
    ],
)
def test_who_has_the_token_and_comes_from_here_is_let_in(headers, query):
    assert ACCESS.refusal(headers, query) == ""


@pytest.mark.parametrize(
    ("headers", "query", "said"),
    [
        ({"host": "127.0.0.1:8123"}, "", "token"),
        ({"host": "127.0.0.1:8123"}, "token=wrong", "token"),
        ({"host": "127.0.0.1:8123"}, "token=", "token"),
        (GOOD | {"cookie": "odescope-8123=wrong"}, "", "token"),
        (GOOD | {"cookie": "odescope-9999=right"}, "", "token"),
        (GOOD | {"cookie": "\x00;=;;=\xff"}, "", "token"),
        (GOOD | {"host": "evil.example"}, "token=right", "its own address"),
        (GOOD | {"host": "127.0.0.1"}, "", "its own address"),
        (GOOD | {"host": "127.0.0.1:8124"}, "", "its own address"),
        ({"cookie": GOOD["cookie"]}, "", "its own address"),
        (GOOD | {"origin": "http://evil.example"}, "", "another one"),
        (GOOD | {"origin": "null"}, "", "another one"),
        (GOOD | {"origin": "https://127.0.0.1:8123"}, "", "another one"),
        (GOOD | {"origin": "http://127.0.0.1:8124"}, "", "another one"),
    ],
)
def test_everyone_else_is_refused(headers, query, said):
    assert said in ACCESS.refusal(headers, query)


def answered(kind, headers, query=b"", path="/data"):
    """Return what the guard sends for a request, and whether the application was asked."""
    asked, sent = [], []

    async def application(scope, receive, send):
        asked.append(scope["path"])
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.append(message)

    raw = [(name.encode(), value.encode("latin-1")) for name, value in headers.items()]
    scope = {"type": kind, "headers": raw, "query_string": query, "path": path}
    asyncio.run(Guard(application, ACCESS)(scope, None, send))
    return sent, asked


def test_a_websocket_is_refused_before_it_opens():
    sent, asked = answered("websocket", GOOD | {"origin": "http://evil.example"})
    assert [m["type"] for m in sent] == ["websocket.close"]
    assert asked == []
    assert answered("websocket", GOOD | {"origin": "http://127.0.0.1:8123"})[1] == ["/data"]


def test_the_token_goes_from_the_address_into_a_cookie():
    sent, asked = answered("http", {"host": "127.0.0.1:8123"}, b"token=right&name=a%26b", "//evil.example/look")
    assert asked == []
    headers = dict(sent[0]["headers"])
    assert sent[0]["status"] == 303
    assert headers[b"location"] == b"/evil.example/look?name=a%26b"
    cookie = headers[b"set-cookie"].decode()
    assert cookie.startswith("odescope-8123=right;")
    assert {"HttpOnly", "SameSite=Strict"} <= {part.strip() for part in cookie.split(";")}


def test_pages_say_that_nothing_may_be_loaded_from_elsewhere():
    sent, asked = answered("http", GOOD)
    assert asked == ["/data"]
    policy = dict(sent[0]["headers"])[b"content-security-policy"].decode()
    assert policy.startswith("default-src 'self'")
    assert "frame-ancestors 'none'" in policy
    assert "http:" not in policy.replace("ws:", "")


def test_every_workbench_has_a_token_of_its_own():
    tokens = {Access(1).token for _ in range(20)}
    assert len(tokens) == 20
    assert min(map(len, tokens)) >= 40
