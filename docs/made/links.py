"""Every link of the built site leads somewhere: python docs/made/links.py docs/_build/html.

Sphinx warns of links between pages that lead nowhere, but not of those that a theme or a docstring writes.
What lies outside the site is not asked for: the build needs no network.
"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LEADS = {"a": "href", "link": "href", "img": "src", "script": "src", "source": "srcset"}


class Page(HTMLParser):
    """What one page links to, and which places on it can be linked to."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.links: set[str] = set()
        self.places: set[str] = set()
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note links and places of an element."""
        told = dict(attrs)
        if link := told.get(LEADS.get(tag, "")):
            self.links.add(link)
        self.places |= {place for name in ("id", "name") if (place := told.get(name))}


def broken(folder: Path) -> list[str]:
    """Find links of a built site that lead nowhere.

    Parameters
    ----------
    folder : path
        The site.

    Returns
    -------
    list of str
        Page and link of each.
    """
    pages = {path.resolve(): Page(path) for path in sorted(folder.rglob("*.html"))}
    found = []
    for path, page in pages.items():
        for link in sorted(page.links):
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or link == "#":
                continue
            there = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            lacks_place = parts.fragment and there in pages and unquote(parts.fragment) not in pages[there].places
            if not there.is_file() or lacks_place:
                found.append(f"{path.relative_to(folder.resolve())}: {link}")
    return found


if __name__ == "__main__":
    lost = broken(Path(sys.argv[1]))
    print(*lost, f"{len(lost)} broken links", sep="\n")
    sys.exit(bool(lost))
