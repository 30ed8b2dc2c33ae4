"""Sections of a report page: protocol, content, and registry.

A page consists of the sections in `SECTIONS` that apply to its content, in the order of
`ReportSection.place`. To add a section, also from another package, derive a class from
`ReportSection` and register an instance, or its location (``"module:attribute"``). The template is
``my_package/templates/mounts.html``, see `updyn.report.templates`::

    class Mounts(ReportSection):
        anchor = "mounts"
        name = heading = "Mounts"
        place = 450
        template = "my_package/mounts.html"

        def context(self, content):
            return {"mounts": content.further["mounts"]}

    SECTIONS.register("mounts.table", "my_package.mounts:MOUNTS")
    updyn.write_report(result, "report.html", mounts=found)

The text before the dot in the registered name is the name of the object that the section shows. The
section is loaded only if the page has such an object. A name without a dot belongs to a section
about the update itself. The entry-point group is ``updyn.report_sections``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

from updyn.correlation.model_modes import ModelModes
from updyn.frf import FRF
from updyn.model import Model
from updyn.registry import Registry
from updyn.report.data import ReportData, gather, gather_start
from updyn.report.element_motion import Motion, gather_motions
from updyn.report.plots import Figure
from updyn.report.start import Start
from updyn.report.templates import render_template
from updyn.updating.judge.modal_table import ModalTable
from updyn.updating.modes import compare_start_modes, modal_table
from updyn.updating.result import JointResult, UpdateResult

__all__ = [
    "SECTIONS",
    "Headline",
    "PageContent",
    "ReportSection",
    "list_shown_objects",
    "select_sections",
]


@dataclass(frozen=True, eq=False)
class PageContent:
    """The objects shown on a page.

    Attributes
    ----------
    update : UpdateResult, JointResult or None
        The update of one or several tests; None on a page about another subject.
    further : mapping of str to object
        Objects by name for additional sections, such as ``"uncertainty"`` from `updyn.sample`.
    """

    update: UpdateResult | JointResult | None = None
    further: Mapping[str, Any] = field(default_factory=dict)

    @property
    def tests(self) -> Mapping[str, UpdateResult]:
        """Results by name of the test; the name of a single test is empty."""
        if self.update is None:
            return {}
        return self.update.results

    @property
    def start(self) -> Start | None:
        """The model and test before any fit, if the page is about these; else None."""
        found = self.further.get("start")
        return found if isinstance(found, Start) else None

    @property
    def start_model(self) -> Model:
        """The model before the update, with the unknowns at their start."""
        if self.start is not None:
            return self.start.model
        return self.result.parameters.at_start(self.result.start)

    @property
    def has_frfs(self) -> bool:
        """Whether the page shows a single test with FRFs."""
        if self.start is not None:
            return isinstance(self.start.data, FRF)
        return isinstance(self.update, UpdateResult) and isinstance(self.update.data, FRF)

    @property
    def has_one_test(self) -> bool:
        """Whether the page shows the update of a single test."""
        return isinstance(self.update, UpdateResult)

    @cached_property
    def single_tests(self) -> Mapping[str, PageContent]:
        """The content of the page of each of several tests, by name; empty for a single test."""
        if not isinstance(self.update, JointResult):
            return {}
        return {name: PageContent(test) for name, test in self.tests.items()}

    @cached_property
    def result(self) -> UpdateResult:
        """The result, or the first of several with the common title; `LookupError` if none."""
        if self.update is None:
            raise LookupError("this page shows no update")
        if isinstance(self.update, JointResult):
            return replace(self.update.first, title=self.update.title)
        return self.update

    @cached_property
    def data(self) -> ReportData:
        """Measured and computed FRFs, computed at first use."""
        return gather(self.result) if self.start is None else gather_start(self.start)

    @cached_property
    def motions(self) -> tuple[tuple[Motion, ...], tuple[str, ...]]:
        """Largest motion of nonlinear elements in each test, and notes on missing ones."""
        return gather_motions(self.tests)

    @cached_property
    def modes(self) -> ModalTable:
        """Modal table, computed at first use if the result has none."""
        if self.start is not None:
            start = self.start
            return start.table or compare_start_modes(self.start_modes, start.data, start.modes)
        return self.result.modes or modal_table(self.result)

    @cached_property
    def start_modes(self) -> ModelModes:
        """The modes of the model before the update."""
        known = None if self.start is None else self.start.model_modes
        return known or ModelModes(self.start_model)


@dataclass(frozen=True, slots=True)
class Headline:
    """A verdict of a section for the first screen: text and kind (good, warn or bad)."""

    text: str
    kind: str


class ReportSection:
    """One section of a page. Derive from it, set its attributes and define `context`.

    Attributes
    ----------
    anchor : str
        Id of the section, unique in the page.
    name : str
        Entry in the table of contents.
    heading : str
        Heading.
    place : float
        Sort key. Built-in sections use numbers below 100 or hundreds from 100 to 1200, and
        ``provenance``, the last section, 9000.
    template : str
        Package and file of the template, as in `updyn.report.templates`.
    needs_frfs : bool
        Whether the section shows measured FRFs; if so, it is omitted for a modal test.
    of_start : bool
        Whether the section is also shown on the page about a model and a test before any fit.
    first_screen : bool
        Whether the section is unfolded on pages with folded sections, such as the report of an
        update.
    """

    anchor: ClassVar[str]
    name: ClassVar[str]
    heading: ClassVar[str]
    place: ClassVar[float]
    template: ClassVar[str]
    needs_frfs: ClassVar[bool] = False
    of_start: ClassVar[bool] = False
    first_screen: ClassVar[bool] = False

    def applies(self, content: PageContent) -> bool:
        """Whether the section is shown; by default on pages about a single test."""
        if content.start is not None and not self.of_start:
            return False
        if self.needs_frfs:
            return content.has_frfs
        return content.has_one_test or content.start is not None

    def figures(self, content: PageContent) -> dict[str, Figure]:
        """Return the figures as plotly data, by a name that is unique in the page."""
        return {}

    def context(self, content: PageContent) -> dict[str, object]:
        """Return the variables of the template by name; ``figures`` and ``fitted`` are added."""
        return {}

    def body(self, content: PageContent, figures: Mapping[str, Figure]) -> str:
        """Return the HTML below the heading, by default rendered from the template.

        Parameters
        ----------
        content : Content
            The objects shown on the page.
        figures : mapping of str to Figure
            The figures of the section.

        Returns
        -------
        str
            HTML. If it is blank, the section is omitted.
        """
        context = self.context(content)
        fitted = content.start is None
        return render_template(self.template, figures=figures, fitted=fitted, **context)

    def embedded_data(self, content: PageContent) -> dict[str, object]:
        """Return data for the scripts, ready for JSON, by id of the element that holds them."""
        return {}

    def headline(self, content: PageContent) -> Headline | None:
        """Return the verdict of the section for the first screen of an update; None without one."""
        return None

    def script(self) -> str:
        """Return JavaScript that runs after the figures are drawn."""
        return ""

    def render(
        self, content: PageContent, figures: Mapping[str, Figure], *, folds: bool = False
    ) -> str:
        """Return the section as HTML; empty if its body is blank.

        Parameters
        ----------
        content : Content
            The objects shown on the page.
        figures : mapping of str to Figure
            The figures of the section.
        folds : bool
            Whether the page folds sections that do not belong to the first screen.

        Returns
        -------
        str
        """
        body = self.body(content, figures)
        if not body.strip():
            return ""
        folded = folds and not self.first_screen
        return render_template("updyn.report/section.html", section=self, body=body, folded=folded)


#: Sections by name, loaded when a page needs them.
SECTIONS: Registry[ReportSection] = Registry(
    "report section",
    "updyn.report_sections",
    {
        "changes": "updyn.report.changes:CHANGES",
        "tests": "updyn.report.head:TESTS",
        "channels": "updyn.report.channels:CHANNELS",
        "all-channels": "updyn.report.overlay:ALL_CHANNELS",
        "frfs": "updyn.report.overlay:FRFS",
        "agreement": "updyn.report.agreement:AGREEMENT",
        "elements": "updyn.report.elements:ELEMENTS",
        "modes": "updyn.report.modes:MODES",
        "structure": "updyn.report.structure:STRUCTURE",
        "viewer": "updyn.report.structure:VIEWER",
        "unknowns": "updyn.report.unknowns:UNKNOWNS",
        "uncertainty.intervals": "updyn.report.uncertainty:UNCERTAINTY",
        "levels.information": "updyn.report.levels:LEVELS",
        "accept.requirements": "updyn.report.acceptance:REQUIREMENTS",
        "population.scatter": "updyn.report.population:POPULATION",
        "identifiability": "updyn.report.identifiability:IDENTIFIABILITY",
        "held": "updyn.report.regularisation:REGULARISATION",
        "convergence": "updyn.report.convergence:CONVERGENCE",
        "validation": "updyn.report.agreement:VALIDATION",
        "residual": "updyn.report.residual:RESIDUAL",
        "noise": "updyn.report.residual:NOISE",
        "plant.plant": "updyn.control.report.plant:PLANT",
        "plant.servo": "updyn.control.report.servo:SERVO",
        "provenance": "updyn.report.provenance:PROVENANCE",
        "comparison.table": "updyn.report.comparison:METHODS",
        "comparison.frfs": "updyn.report.comparison:FRFS",
        "comparison.bars": "updyn.report.comparison:BARS",
        "comparison.lines": "updyn.report.comparison:FEWEST_LINES",
        "comparison.limits": "updyn.report.comparison:LIMITS",
        "candidates.table": "updyn.report.candidates:TABLE",
        "candidates.bands": "updyn.report.candidates:BANDS",
        "located.elements": "updyn.report.location:ELEMENTS",
        "located.searches": "updyn.report.location:SEARCHES",
        "location.candidates": "updyn.report.location:CANDIDATES",
        "location.places": "updyn.report.location:PLACES",
        "plan.layout": "updyn.report.planning:LAYOUT",
        "plan.expected": "updyn.report.planning:EXPECTED",
        "plan.worth": "updyn.report.planning:WORTH",
        "plan.criteria": "updyn.report.planning:RIVALS",
        "start.findings": "updyn.report.before:FINDINGS",
        "start.expected": "updyn.report.before:EXPECTED",
        "start.matching": "updyn.report.before:MATCHING",
        "identified.diagram": "updyn.report.identified:DIAGRAM",
        "identified.shapes": "updyn.report.identified:SHAPES",
        "identified.modes": "updyn.report.identified:MODES",
    },
)


def select_sections(content: PageContent) -> list[ReportSection]:
    """Return the sections that apply to this content, in page order."""
    chosen = []
    for name in SECTIONS:
        shown = _find_object(name)
        if not shown or shown in content.further:
            section = SECTIONS[name]
            if section.applies(content):
                chosen.append(section)
    return sorted(chosen, key=lambda section: section.place)


def list_shown_objects() -> set[str]:
    """Return the names of the additional objects for which sections exist."""
    return {_find_object(name) for name in SECTIONS} - {""}


def _find_object(registered: str) -> str:
    """Return the name of the object that a section shows; empty for a section about the update."""
    return registered.rpartition(".")[0]
