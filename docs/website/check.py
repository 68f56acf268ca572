"""Check built pages: every link of every page leads to a page and a place in it, and nothing is fetched from elsewhere.

python -m website.check OUT/html
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADS = {("img", "src"), ("script", "src"), ("iframe", "src"), ("source", "src")}


class Html(HTMLParser):
    """The links of a page, the places in it, and what it loads."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.places: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.places.update(given[name] for name in ("id", "name") if name in given)
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if tag == "link" and given.get("rel") in ("stylesheet", "preload", "icon"):
            self.loads.append(given.get("href", ""))
        self.loads += [given[name] for of, name in LOADS if of == tag and name in given]


def wrong(folder: Path) -> Iterator[str]:
    """Yield what is wrong with the pages below a folder."""
    pages = {path: Html(path.read_text(encoding="utf-8")) for path in sorted(folder.rglob("*.html"))}
    for path, page in pages.items():
        name = path.relative_to(folder)
        for address in page.loads:
            if urlsplit(address).netloc:
                yield f"{name}: loads {address}"
        for address in [*page.links, *page.loads]:
            parts = urlsplit(address)
            if parts.scheme or parts.netloc or address in ("", "#"):
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.is_file():
                yield f"{name}: {address} leads nowhere"
            elif parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].places:
                yield f"{name}: {address}: no such place"
    for path in folder.rglob("*.css"):
        if "url(http" in path.read_text(encoding="utf-8"):
            yield f"{path.relative_to(folder)}: loads from elsewhere"


if __name__ == "__main__":
    root = Path(sys.argv[1]).resolve()
    count = 0
    for text in wrong(root):
        print(text, flush=True)
        count += 1
    if not count:
        pages = len(list(root.rglob("*.html")))
        print(f"{pages} pages, every link leads somewhere, nothing is loaded from elsewhere")
    sys.exit(bool(count))
