"""What the site has beside its pages: parts made from the program itself, links out of docs/, colours of blocks.

A page asks for such a part by a comment, `<!-- made: command_line -->`: `text()` of the module of that name here.

The parts are made without what builds the site: their tests need it as little as those who only read the pages.
"""

import re
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from docutils import nodes
    from sphinx.application import Sphinx

OUTSIDE = {"../README.md": "index.md", "../CONTRIBUTING.md": "contributing.md"}  # pages that stand above docs/
MADE = re.compile(r"^<!-- made: (\w+) -->$", re.MULTILINE)
LANGUAGES = (  # what a block is, by what one of its lines begins with
    (r"(rtpiv|make|python3?|pip|dask|source|git|cd) ", "bash"),
    (r"(from \w[\w.]* import|import|def|@\w+|class) ?", "python"),
    (r"[\w-]+:( |$)", "yaml"),
)


def setup(app: "Sphinx") -> dict[str, Any]:
    """Register with Sphinx."""
    app.connect("source-read", _write_made)
    app.connect("source-read", _link_inside)
    app.connect("doctree-read", _name_languages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def _write_made(app: "Sphinx", page: str, source: list[str]) -> None:
    """Put the parts of a page in where it asks for them."""
    source[0] = MADE.sub(lambda asked: import_module(f"made.{asked[1]}").text(), source[0])


def _link_inside(app: "Sphinx", page: str, source: list[str]) -> None:
    """Let links to pages above docs/ lead to the pages of the site that have their text."""
    up = "../" * page.count("/")
    for there, here in OUTSIDE.items():
        source[0] = source[0].replace(f"]({up}{there}", f"]({up}{here}")


def _name_languages(app: "Sphinx", tree: "nodes.document") -> None:
    """Indented blocks do not say what they are; their lines do."""
    for block in tree.findall(lambda node: node.tagname == "literal_block"):
        if block.get("language", "none") in ("none", "text", "default"):
            text = block.astext()
            named = (name for begins, name in LANGUAGES if re.search(f"^{begins}", text, re.MULTILINE))
            block["language"] = next(named, "text")
