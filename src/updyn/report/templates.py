"""HTML from Jinja2 templates, in one environment for the templates of all packages.

A template is named by package and file: ``"updyn.report/agreement.html"`` is
``templates/agreement.html`` in `updyn.report`. It imports the macros that all sections share::

    {% from "updyn.report/macros.html" import figure, row, table with context %}

Inserted values are escaped, and a name missing in the context is an error. The filters are
functions of `updyn.report.formats`.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from updyn.io.atomic import atomic_path
from updyn.report import formats
from updyn.style import css
from updyn.viewer.encoding import embedded_json

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["asset", "render_template", "write_page"]

#: Functions of `updyn.report.formats` used as template filters.
_FILTERS = (
    "agreement_name",
    "capitalize_first",
    "combination_words",
    "decibels",
    "extent",
    "figure_of_agreement",
    "format_count",
    "number",
    "option_words",
    "paragraphs",
    "quantity_words",
    "split_more",
    "unknown_words",
    "weighted_sum",
)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    environment = Environment(
        loader=FunctionLoader(_read_template),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    for name in _FILTERS:
        environment.filters[name] = getattr(formats, name)
    environment.filters["embedded_json"] = embedded_json
    environment.globals["asset"] = asset
    environment.globals["style_variables"] = css
    return environment


def _read_template(name: str) -> str:
    package, _, file = name.partition("/")
    return (resources.files(package) / "templates" / file).read_text(encoding="utf-8")


def render_template(name: str, **context: object) -> str:
    """Return a template, such as ``"updyn.report/agreement.html"``, rendered with variables."""
    return _environment().get_template(name).render(context)


def asset(name: str) -> str:
    """Return a script or style sheet of the package, escaped for embedding in an HTML element."""
    text = (resources.files("updyn.report") / "assets" / name).read_text(encoding="utf-8")
    return (
        text.replace("</script", "<\\/script")
        .replace("</style", "<\\/style")
        .replace("<!--", "<\\!--")
    )


def write_page(page: str, path: str | PathLike[str]) -> Path:
    """Write a page atomically, replacing an existing file, and return its path."""
    target = Path(path)
    with atomic_path(target) as temporary:
        Path(temporary).write_text(page, encoding="utf-8", newline="\n")
    return target
