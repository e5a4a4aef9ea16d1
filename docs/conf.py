"""Sphinx's settings: ``make docs`` builds the pages of this folder into build/docs."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

# Before autodoc, which imports with TYPE_CHECKING set: pydantic does not bear that.
import api.client  # noqa: E402, F401

project = "brdf-fitter"
author = "The brdf-fitter developers"
copyright = author
release = re.findall(r'"(.+)"', (ROOT / "fitter" / "_version.py").read_text())[0]

extensions = ["myst_parser", "sphinx.ext.autodoc", "docstrings"]
html_theme = "furo"
html_title = f"brdf-fitter {release}"
html_show_sphinx = False
html_copy_source = False

myst_heading_anchors = 4  # as GitHub makes them
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
nitpicky = True

LINK = re.compile(r"^\| \[[^\]]*\]\(([\w-]+)\.(?:md|rst)\)", re.MULTILINE)


def contents(_app: Sphinx, name: str, source: list[str]) -> None:
    """The tables of the index are the site's contents, in their order and under their headings."""
    if name != "index":
        return
    trees: list[str] = []
    for section in re.split(r"^## ", source[0], flags=re.MULTILINE)[1:]:
        pages = LINK.findall(section)
        if pages:
            caption = section.splitlines()[0]
            trees += ["", "```{toctree}", ":hidden:", f":caption: {caption}", "", *pages, "```"]
    source[0] += "\n".join(trees) + "\n"


def setup(app: Sphinx) -> None:
    app.connect("source-read", contents)
