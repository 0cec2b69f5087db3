"""How `make docs` builds the site: Sphinx reads these pages, MyST their Markdown (docs/adr/0035)."""

import importlib.metadata
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))  # `made`: what is written from the program itself

project = "rtpiv"
author = "the rtpiv authors"
release = version = importlib.metadata.version("rtpiv")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "made"]
exclude_patterns = ["_build"]

autodoc_typehints = "none"  # types stand in the docstrings, in words
autodoc_member_order = "bysource"
napoleon_google_docstring = False

myst_enable_extensions = ["html_image", "deflist", "fieldlist"]
myst_heading_anchors = 4  # page.md#a-heading, as code forges have it
highlight_language = "text"  # indented blocks: `made` looks what each of them is

suppress_warnings = []  # none: a page that Sphinx doubts is a page to mend

html_theme = "furo"
html_title = "rtpiv"
html_static_path = ["made/site.css"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
