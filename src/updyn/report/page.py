"""`write_report`: write an update as one self-contained HTML page."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path

from updyn.errors import OptionError, suggest
from updyn.report.agreement import agreement_figures
from updyn.report.head import agreement, head, joint_head, page_title
from updyn.report.plots import Figure
from updyn.report.section import PageContent, ReportSection, list_shown_objects, select_sections
from updyn.report.templates import render_template, write_page
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.profile import Profiles
from updyn.updating.result import JointResult, UpdateResult
from updyn.viewer.page import POLICY

__all__ = ["assemble", "render", "write_report"]


def write_report(
    result: UpdateResult | JointResult,
    path: str | PathLike[str],
    uncertainty: Draws | Profiles | None = None,
    **further: object,
) -> Path:
    """Write an update as one HTML page that needs no network and no other file.

    The first screen shows the verdict, the next step, the worst and the median channel before and
    after the update, and the largest changes of the unknowns. Below it are folded sections, drawn
    when unfolded: the structure in three dimensions (if the model has a geometry), all changes with
    their intervals, modes, measured FRFs over those of the model before and after, the correlation
    by channel, the unknowns with their uncertainty, their identifiability, the convergence history,
    validation, residual, noise and provenance. The FRFs of the models are computed for the page at
    the lines of the data and at additional lines near resonances.

    Parameters
    ----------
    result : UpdateResult or JointResult
        Result of `updyn.update`, with any status. The page of several tests shows their common
        results and links to the page of each test, ``NAME/report.html`` in the same folder, which
        is written from the result of that test.
    path : str or path-like
        The file. An existing file is replaced only after the new page is complete.
    uncertainty : Draws or Profiles, optional
        Result of `updyn.sample`, `updyn.bootstrap` or `updyn.profile`, shown in an additional
        section.
    **further : object
        Objects for additional sections, by the names that `updyn.report.section.SECTIONS` lists:
        ``plant``, the result of ``[plant]`` of a job.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OptionError
        If no section shows an object of such a name.

    Notes
    -----
    A page takes 1.6 MB and, for each channel and line drawn, 32 bytes (38 with coherence). Beyond
    `REPORT_SIZE.frf_bytes`, lines are thinned and the page says so.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> updyn.write_report(result, "report.html").name
    'report.html'
    """
    shown = list_shown_objects()
    for name in further:
        if name not in shown:
            raise OptionError(f"{name}: no report section shows it; {suggest(name, sorted(shown))}")
    return write_page(render(result, uncertainty, **further), path)


def render(
    result: UpdateResult | JointResult,
    uncertainty: Draws | Profiles | None = None,
    **further: object,
) -> str:
    """Return the page of an update as HTML."""
    if uncertainty is not None:
        further["uncertainty"] = uncertainty
    content = PageContent(result, further)
    if isinstance(result, JointResult):
        top, drawn = joint_head(content, result)
    else:
        figures = agreement_figures(result, content.data) if content.has_frfs else agreement(result)
        top, drawn = head(content, figures)
    version = content.result.versions.get("updyn", "")
    return assemble(content, top, page_title(content), version, figures=drawn, folds=True)


def assemble(
    content: PageContent,
    head: str,
    title: str,
    version: str,
    *,
    figures: Mapping[str, Figure] | None = None,
    folds: bool = False,
) -> str:
    """Return a page as HTML with every section that applies to its content.

    `head` is HTML, with `figures` by name. With `folds`, sections are folded that are not
    `ReportSection.unfolded`.
    """
    sections: list[ReportSection] = []
    bodies: list[str] = []
    figures = dict(figures or {})
    embedded: dict[str, object] = {}
    for section in select_sections(content):
        section_figures = section.figures(content)
        text = section.render(content, section_figures, folds=folds)
        if text:
            sections.append(section)
            bodies.append(text)
            figures |= section_figures
            embedded |= section.embedded_data(content)
    return render_template(
        "updyn.report/page.html",
        policy=POLICY,
        version=version,
        title=title,
        head=head,
        sections=sections,
        folds=folds,
        bodies=bodies,
        figures=figures,
        embedded=embedded,
        scripts=[section.script() for section in sections],
    )
