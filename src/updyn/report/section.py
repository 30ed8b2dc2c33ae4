"""Sections of a report page: their protocol, their content, and their registry.

A page is assembled from the sections in `SECTIONS` that apply to its content, in the order of
their `Section.place`. To add one, also from another package, derive a class from `Section` and
register an instance, or where one is found (``"module:attribute"``); its template is
``my_package/templates/mounts.html``, see `updyn.report.templates`::

    class Mounts(Section):
        anchor = "mounts"
        name = heading = "Mounts"
        place = 450
        template = "my_package/mounts.html"

        def context(self, content):
            return {"mounts": content.further["mounts"]}

    SECTIONS.register("mounts.table", "my_package.mounts:MOUNTS")
    updyn.write_report(result, "report.html", mounts=found)

The text before the dot in the registered name is the name of the object that the section shows;
the section is loaded only where there is such an object. A name without a dot is that of a section
about the update itself. The group of entry points is ``updyn.report_sections``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

from updyn.frf import FRF
from updyn.model import Model
from updyn.registry import Registry
from updyn.report.data import ReportData, gather, gather_start
from updyn.report.plots import Figure
from updyn.report.start import Start
from updyn.report.templates import render_template
from updyn.updating.judge.modal_table import ModalTable
from updyn.updating.modes import modal_table, start_table
from updyn.updating.result import JointResult, UpdateResult

__all__ = ["SECTIONS", "Content", "Section", "objects_shown", "sections_of"]


@dataclass(frozen=True, eq=False)
class Content:
    """The objects that a page shows.

    Attributes
    ----------
    update : UpdateResult, JointResult or None
        The update of one test or of several tests; None on a page about something else.
    further : mapping of str to object
        Objects by name for sections of their own, such as ``"uncertainty"``, from `updyn.sample`.
    """

    update: UpdateResult | JointResult | None = None
    further: Mapping[str, Any] = field(default_factory=dict)

    @property
    def tests(self) -> Mapping[str, UpdateResult]:
        """Results by the name of their test; a single one has no name."""
        if self.update is None:
            return {}
        return self.update.results

    @property
    def start(self) -> Start | None:
        """The model and the test before any fit, on a page about these."""
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
        """Whether the page shows one test that measured FRFs."""
        if self.start is not None:
            return isinstance(self.start.data, FRF)
        return isinstance(self.update, UpdateResult) and isinstance(self.update.data, FRF)

    @property
    def of_one_test(self) -> bool:
        """Whether the page shows the update of one test."""
        return isinstance(self.update, UpdateResult)

    @cached_property
    def result(self) -> UpdateResult:
        """The result; of several tests the first, with the title of all.

        Raises
        ------
        LookupError
            If the page shows no update.
        """
        if self.update is None:
            raise LookupError("this page shows no update")
        if isinstance(self.update, JointResult):
            return replace(self.update.first, title=self.update.title)
        return self.update

    @cached_property
    def data(self) -> ReportData:
        """Measured and computed FRFs, computed when first asked for."""
        return gather(self.result) if self.start is None else gather_start(self.start)

    @cached_property
    def modes(self) -> ModalTable:
        """Modal table, made when first asked for where the update has none."""
        if self.start is not None:
            return start_table(self.start.model, self.start.data, self.start.modes)
        return self.result.modes or modal_table(self.result)


class Section:
    """One section of a page; derive from it, set its attributes and define `context`.

    Attributes
    ----------
    anchor : str
        Its id in the page, unique there.
    name : str
        Its entry in the list of contents.
    heading : str
        Its heading.
    place : float
        Sections are shown in ascending order of it. Those of the first screen have tens below 100,
        the other built-in ones the hundreds 100 to 1200; ``provenance``, the last, has 9000.
    template : str
        Package and file of its template, as `updyn.report.templates` has it.
    needs_frfs : bool
        Whether it shows measured FRFs, so that a test that measured modes does not have it.
    of_start : bool
        Whether it belongs to the page about a model and a test before any fit, too.
    first_screen : bool
        Whether it is open where the sections of a page are folded, as in the report of an update.
    """

    anchor: ClassVar[str]
    name: ClassVar[str]
    heading: ClassVar[str]
    place: ClassVar[float]
    template: ClassVar[str]
    needs_frfs: ClassVar[bool] = False
    of_start: ClassVar[bool] = False
    first_screen: ClassVar[bool] = False

    def applies(self, content: Content) -> bool:
        """Whether a page with this content has the section; by default that of one test has."""
        if content.start is not None and not self.of_start:
            return False
        if self.needs_frfs:
            return content.has_frfs
        return content.of_one_test or content.start is not None

    def figures(self, content: Content) -> dict[str, Figure]:
        """Return its figures as plotly data, by a name that is unique in the page."""
        return {}

    def context(self, content: Content) -> dict[str, Any]:
        """Return the variables of the template by name; ``figures`` and ``fitted`` are added."""
        return {}

    def body(self, content: Content, figures: Mapping[str, Figure]) -> str:
        """Return the HTML below the heading, by default that of the template.

        Parameters
        ----------
        content : Content
            The objects that the page shows.
        figures : mapping of str to Figure
            The figures of the section.

        Returns
        -------
        str
            HTML. Where it is blank the section is left out.
        """
        context = self.context(content)
        fitted = content.start is None
        return render_template(self.template, figures=figures, fitted=fitted, **context)

    def embedded(self, content: Content) -> dict[str, Any]:
        """Return data for its scripts, ready for JSON, by the id of the element that holds them."""
        return {}

    def script(self) -> str:
        """Return JavaScript that runs once the figures are drawn."""
        return ""

    def render(
        self, content: Content, figures: Mapping[str, Figure], *, folds: bool = False
    ) -> str:
        """Return the section as HTML; empty where its body is blank.

        Parameters
        ----------
        content : Content
            The objects that the page shows.
        figures : mapping of str to Figure
            The figures of the section.
        folds : bool
            Whether the page folds what does not belong to the first screen.

        Returns
        -------
        str
        """
        body = self.body(content, figures)
        if not body.strip():
            return ""
        folded = folds and not self.first_screen
        return render_template("updyn.report/section.html", section=self, body=body, folded=folded)


#: Sections by name, each loaded when a page needs it.
SECTIONS: Registry[Section] = Registry(
    "report section",
    "updyn.report_sections",
    {
        "changes": "updyn.report.changes:CHANGES",
        "tests": "updyn.report.head:TESTS",
        "channels": "updyn.report.channels:CHANNELS",
        "all-channels": "updyn.report.overlay:ALL_CHANNELS",
        "frfs": "updyn.report.overlay:FRFS",
        "agreement": "updyn.report.agreement:AGREEMENT",
        "modes": "updyn.report.modes:MODES",
        "structure": "updyn.report.structure:STRUCTURE",
        "viewer": "updyn.report.structure:VIEWER",
        "unknowns": "updyn.report.unknowns:UNKNOWNS",
        "uncertainty.intervals": "updyn.report.uncertainty:UNCERTAINTY",
        "identifiability": "updyn.report.identifiability:IDENTIFIABILITY",
        "held": "updyn.report.regularisation:HELD",
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


def sections_of(content: Content) -> list[Section]:
    """Return the sections that apply to this content, in their order on the page."""
    chosen = []
    for name in SECTIONS:
        shown = _object_of(name)
        if not shown or shown in content.further:
            section = SECTIONS[name]
            if section.applies(content):
                chosen.append(section)
    return sorted(chosen, key=lambda section: section.place)


def objects_shown() -> set[str]:
    """Return the names of the objects beside an update that there are sections for."""
    return {_object_of(name) for name in SECTIONS} - {""}


def _object_of(registered: str) -> str:
    """Return the name of the object that a section shows; empty where it shows the update."""
    return registered.rpartition(".")[0]
