"""Checks a built site: pages load nothing from the network, and no link within it is dead.

python .ci/check_site.py FOLDER
"""

from __future__ import annotations

import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADING = {"src", "srcset", "data", "poster", "background"}  # attributes whose address a browser fetches by itself
REMOTE = re.compile(r"(?:https?:)?//")
STYLED = re.compile(r"""(?:url\(\s*|@import\s+)["']?((?:https?:)?//[^"')\s]+)""")


class Page(HTMLParser):
    """What a page loads, where its links lead, and which places of its own a link may name."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.links: list[str] = []
        self.places: set[str] = set()
        self.feed(text)
        self.loads += STYLED.findall(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect from one element."""
        for name, value in attrs:
            if name in ("id", "name") and value:
                self.places.add(value)
            elif name in LOADING or (name == "href" and tag not in ("a", "area")):
                relation = dict(attrs).get("rel") if tag == "link" else None
                (self.links if relation in ("next", "prev", "canonical") else self.loads).append(value or "")
            elif name == "href":
                self.links.append(value or "")


def wrong(site: Path) -> list[str]:
    """Return one line for everything that is wrong with a built site."""
    pages = {path: Page(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}
    found = []
    for path, page in pages.items():
        name = path.relative_to(site).as_posix()
        found += [f"{name} loads {address}" for address in page.loads if REMOTE.match(address)]
        for address in [*page.links, *(a for a in page.loads if not a.startswith(("data:", "#")))]:
            parts = urlsplit(address)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path.resolve()
            if not target.is_file():
                found.append(f"{name} leads to {address}, which is not there")
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].places:
                found.append(f"{name} leads to {address}, a page without that place")
    for path in sorted(site.rglob("*.css")):
        loads = STYLED.findall(path.read_text(encoding="utf-8"))
        found += [f"{path.relative_to(site).as_posix()} loads {address}" for address in loads]
    return found if pages else [f"{site} holds no page"]


if __name__ == "__main__":
    site = Path(sys.argv[1]).resolve()
    problems = wrong(site)
    sys.exit("\n".join(problems) if problems else None)
