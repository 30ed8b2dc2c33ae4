"""Settings of the manual: `make docs` builds it from the pages in docs/ and from the package."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import updyn

SITE = Path(__file__).parent
sys.path.insert(0, str(SITE))

import gallery  # noqa: E402
import reference  # noqa: E402

import pages  # noqa: E402

project = "updyn"
author = "The updyn developers"
copyright = author
version = release = updyn.__version__

extensions = [
    "myst_nb",  # with myst_parser
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
]
root_doc = "site/index"
myst_heading_anchors = 6
nb_execution_mode = "force"
nb_execution_raise_on_error = True  # each notebook asserts its numbers
nb_execution_timeout = 300  # seconds a cell
nb_merge_streams = True

autosummary_generate = False
autodoc_typehints = "none"  # numpydoc's sections hold them, with shape and unit
autodoc_member_order = "bysource"
numpydoc_show_class_members = False

html_theme = "furo"
html_title = "updyn"
html_show_sourcelink = False
html_copy_source = False

reference.write(SITE / "api")
pages.write(SITE / "api")
gallery.write(SITE / "api")


def setup(app: Any) -> None:
    """Register what turns texts written for a code host and a terminal into those of the site."""
    app.connect("source-read", _to_site)
    app.connect("autodoc-process-docstring", _escape, priority=400)


def _to_site(app: Any, name: str, source: list[str]) -> None:
    text = pages.to_site(source[0], pages.DOCS / f"{name}.md")
    source[0] = re.sub(r"^/(\S*\*\S*)\n", _where_any, text, flags=re.MULTILINE)


def _where_any(found: re.Match[str]) -> str:
    """Sections name kinds of pages of which there may be none."""
    return found[0] if any(pages.DOCS.glob(f"{found[1]}.md")) else ""


def _escape(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Escape the bars of magnitudes such as |H|, which are not substitutions."""
    lines[:] = [
        "".join(
            p if p.startswith("`") else p.replace("|", r"\|") for p in re.split("(``?[^`]*``?)", x)
        )
        for x in lines
    ]
