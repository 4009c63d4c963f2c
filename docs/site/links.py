"""Checks of the site: every link leads somewhere, and nothing is loaded from a network."""

import re
from collections.abc import Iterator, Mapping
from html.parser import HTMLParser
from pathlib import Path
from typing import final
from urllib.parse import unquote, urlparse

_LOADED = {"img", "script", "link", "source", "iframe"}
_IN_STYLE = re.compile(r"url\(\s*['\"]?(https?:)?//|@import\s+['\"]https?:")


@final
class _Page(HTMLParser):
    """What a page links to, what it loads, and the anchors that it has."""

    def __init__(self, text: str):
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.anchors |= {given[key] or "" for key in ("id", "name") if key in given}
        target = given.get("href") or given.get("src")
        if target is None or given.get("rel") == "canonical":
            return
        (self.loaded if tag in _LOADED else self.links).append(target)


def problems(site: Path) -> list[str]:
    """What is wrong with the links of a site, a line each."""
    pages = {file: _Page(file.read_text(encoding="utf-8")) for file in site.rglob("*.html")}
    found: set[str] = set()
    for file, page in pages.items():
        # The page for what is not found is shown at any address.
        if file.name != "404.html":
            where = file.relative_to(site)
            found |= {f"{where}: {text}" for text in _problems_of(file, page, pages)}
    for style in site.rglob("*.css"):
        if _IN_STYLE.search(style.read_text(encoding="utf-8")):
            found.add(f"{style.relative_to(site)}: loads from a network")
    return sorted(found)


def _problems_of(file: Path, page: _Page, pages: Mapping[Path, _Page]) -> Iterator[str]:
    for target in page.links + page.loaded:
        parsed = urlparse(target)
        if parsed.netloc and target in page.loaded:
            yield f"loads {target} from a network"
        if parsed.scheme or parsed.netloc:
            continue
        there = (file.parent / unquote(parsed.path)).resolve() if parsed.path else file
        if there.is_dir():
            there /= "index.html"
        anchor = unquote(parsed.fragment)
        if not there.is_file():
            yield f"{target} leads to no file"
        elif anchor and there in pages and anchor not in pages[there].anchors:
            yield f"{target} leads to no anchor"


def anchors(page: Path) -> set[str]:
    """The anchors of a page."""
    return _Page(page.read_text(encoding="utf-8")).anchors
