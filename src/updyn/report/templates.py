"""HTML from Jinja2 templates: one environment for the templates of all packages.

A template is named by its package and its file: ``"updyn.report/agreement.html"`` is
``templates/agreement.html`` in `updyn.report`. It imports the macros that all sections share::

    {% from "updyn.report/macros.html" import figure, row, table with context %}

Values are escaped where they are inserted, and a name that the context lacks is an error. The
filters are the functions of `updyn.report.formats`.
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from updyn.io.atomic import atomic_path
from updyn.report import formats
from updyn.style import css
from updyn.viewer.encoding import embedded_json

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = ["asset", "render_template", "write_page"]

#: Functions of `updyn.report.formats` that templates use as filters.
_FILTERS = (
    "agreement_name",
    "combination",
    "counted",
    "decibels",
    "extent",
    "figure_of_agreement",
    "number",
    "plain",
    "quantity_words",
    "unknown",
    "weighted_sum",
)


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FunctionLoader, StrictUndefined

    environment = Environment(
        loader=FunctionLoader(_source),
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


def _source(name: str) -> str:
    package, _, file = name.partition("/")
    return (resources.files(package) / "templates" / file).read_text(encoding="utf-8")


def render_template(name: str, **context: Any) -> str:
    """Return the HTML that a template makes of its context.

    Parameters
    ----------
    name : str
        Package and file, such as ``"updyn.report/agreement.html"``.
    **context : object
        The variables of the template.

    Returns
    -------
    str
    """
    return _environment().get_template(name).render(context)


def asset(name: str) -> str:
    """Return a script or style of the package, safe inside the element that holds it."""
    text = (resources.files("updyn.report") / "assets" / name).read_text(encoding="utf-8")
    return (
        text.replace("</script", "<\\/script")
        .replace("</style", "<\\/style")
        .replace("<!--", "<\\!--")
    )


def write_page(page: str, path: str | PathLike[str]) -> Path:
    """Write a page as a whole, which replaces an existing file; return the file."""
    target = Path(path)
    with atomic_path(target) as temporary:
        Path(temporary).write_text(page, encoding="utf-8", newline="\n")
    return target
