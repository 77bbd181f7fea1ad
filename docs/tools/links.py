"""Every reference of a built site: what a page loads, and where its links lead.

    python docs/tools/links.py out/docs

lists the addresses outside, and ends with 1 where a link or an anchor inside leads nowhere, where a
page would load something from elsewhere, or where an address outside is malformed.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

# Attributes through which a browser fetches something to show the page.
LOADING = {
    "script": ("src",),
    "img": ("src", "srcset"),
    "iframe": ("src",),
    "source": ("src", "srcset"),
    "video": ("src", "poster"),
    "audio": ("src",),
    "embed": ("src",),
    "object": ("data",),
    "image": ("href", "xlink:href"),
    "use": ("href", "xlink:href"),
}
LOADING_LINKS = {"stylesheet", "icon", "preload", "prefetch", "preconnect", "modulepreload"}
IN_STYLES = re.compile(r"""(?:url\(\s*|@import\s+)["']?(?P<address>[^"')\s]+)""")
HOST = re.compile(r"^(?=.{4,253}$)([a-z0-9]([a-z0-9-]*[a-z0-9])?\.)+[a-z]{2,}$")


@dataclass
class Page(HTMLParser):
    """What one page loads and links to, and its anchors."""

    loads: list[str] = field(default_factory=list)
    links: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        super().__init__()
        self._in_style = False

    @classmethod
    def of(cls, text: str) -> Page:
        """The page of an HTML text."""
        page = cls()
        page.feed(text)
        return page

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note the references of one element."""
        given = {name: value for name, value in attrs if value is not None}
        self._in_style = tag == "style"
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        for name in LOADING.get(tag, ()):
            if name in given:
                self.loads.append(given[name])
        if tag == "link" and LOADING_LINKS & set(given.get("rel", "").split()):
            self.loads.append(given.get("href", ""))
        self.loads += [found["address"] for found in IN_STYLES.finditer(given.get("style", ""))]

    def handle_endtag(self, tag: str) -> None:
        """Leave a style sheet."""
        if tag == "style":
            self._in_style = False

    def handle_data(self, data: str) -> None:
        """Look into a style sheet inside the page."""
        if self._in_style:
            self.loads += [found["address"] for found in IN_STYLES.finditer(data)]


def outside(address: str) -> bool:
    """Whether an address is on another machine."""
    return bool(urlsplit(address).netloc) or urlsplit(address).scheme in ("http", "https")


def pages(site: Path) -> dict[Path, Page]:
    """Every page of a site, by its path."""
    return {path: Page.of(path.read_text("utf-8")) for path in sorted(site.rglob("*.html"))}


def loaded_from_elsewhere(site: Path) -> list[str]:
    """``page: address`` of what a page or style sheet would fetch from another machine."""
    found = [
        f"{path.relative_to(site)}: {address}"
        for path, page in pages(site).items()
        for address in page.loads
        if outside(address)
    ]
    for path in sorted(site.rglob("*.css")):
        for match in IN_STYLES.finditer(path.read_text("utf-8")):
            if outside(match["address"]):
                found.append(f"{path.relative_to(site)}: {match['address']}")
    return found


def broken(site: Path) -> list[str]:
    """``page: address`` of every link or picture inside the site that leads nowhere."""
    known = pages(site)

    def missing(path: Path, page: Page) -> Iterator[str]:
        for address in (*page.links, *page.loads):
            if outside(address) or urlsplit(address).scheme:
                continue
            place, anchor = (unquote(part) for part in urlsplit(address)[2::2])
            target = (path.parent / place).resolve() if place else path
            target = target / "index.html" if target.is_dir() else target
            anchored = not anchor or target not in known or anchor in known[target].anchors
            if not (target.is_file() and anchored):
                yield address

    site = site.resolve()
    known = {path.resolve(): page for path, page in known.items()}
    return [
        f"{path.relative_to(site)}: {address}"
        for path, page in known.items()
        if path.name != "404.html"  # its links are from the root of a server
        for address in missing(path, page)
    ]


def addresses_outside(site: Path) -> dict[str, set[str]]:
    """Addresses outside to which pages link, with the pages."""
    found: dict[str, set[str]] = {}
    for path, page in pages(site).items():
        for address in filter(outside, page.links):
            found.setdefault(address, set()).add(str(path.relative_to(site)))
    return dict(sorted(found.items()))


def malformed(addresses: dict[str, set[str]]) -> list[str]:
    """Addresses that no browser could open; none is asked for."""
    return [address for address in addresses if not _well_formed(address)]


def _well_formed(address: str) -> bool:
    parts = urlsplit(address)
    plain = not re.search(r"[\s<>\"{}|\\^`]", address)
    return parts.scheme == "https" and HOST.match(parts.hostname or "") is not None and plain


def main() -> int:
    parser = argparse.ArgumentParser(description="Check the references of a built site.")
    parser.add_argument("site", type=Path)
    site = parser.parse_args().site
    addresses = addresses_outside(site)
    for address in addresses:
        print(address)
    problems = [
        *(f"loaded from elsewhere: {found}" for found in loaded_from_elsewhere(site)),
        *(f"leads nowhere: {found}" for found in broken(site)),
        *(f"malformed: {found}" for found in malformed(addresses)),
    ]
    for problem in problems:
        print(problem, file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
