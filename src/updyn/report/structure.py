"""The sections on the structure: the interactive viewer, and a picture that can be printed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from updyn.model import Model
from updyn.report.changes import is_significant
from updyn.report.formats import quantity_words
from updyn.report.picture import picture
from updyn.report.plots import Figure
from updyn.report.scene import colour_by_std, scene_of, sensors_of
from updyn.report.section import PageContent, ReportSection
from updyn.report.templates import render_template
from updyn.text_table import format_change
from updyn.updating.result import UpdateResult
from updyn.viewer.colourings import scale_of_changes
from updyn.viewer.page import fragment, script
from updyn.viewer.scene import Colouring, Scene

__all__ = [
    "STEPS",
    "STRUCTURE",
    "VIEWER",
    "group_changes",
    "group_remarks",
    "structure_of",
]

#: Number of steps of the colour scale on each side of no change.
STEPS = 4
#: Smallest range of the colour scale, in the logarithm of the factor; guards against rounding
#: errors.
_LEAST = 1e-9
_ABOUT = (
    "Sensors and forces, and the change of each part: its stiffness, or, if that is not an unknown,"
    " its mass, then its viscous damping. Colours reach to the largest significant change."
)


class ViewerSection(ReportSection):
    """The structure in three dimensions: modes and operating shapes before and after the update."""

    anchor = "viewer"
    name = "Structure"
    heading = "Structure in three dimensions"
    place = 10

    def applies(self, content: PageContent) -> bool:
        """Whether the page shows a model with a geometry."""
        if content.start is not None:
            return _is_drawn(content.start.model)
        return _find_largest(list(content.tests.values())) is not None

    def body(self, content: PageContent, figures: Mapping[str, Figure]) -> str:
        """Return the viewer with its scene."""
        scene = _scene(content)
        if scene is None:
            return ""
        moves = scene.modes is not None or scene.operating is not None
        return render_template(
            "updyn.report/viewer.html",
            fragment=fragment(scene),
            notes=scene.notes,
            moves=moves,
            fitted=content.start is None,
        )

    def script(self) -> str:
        """Return the script of the viewer, with the call that starts it."""
        return f"{script()}\nupdynViewer.start();"


VIEWER = ViewerSection()


class StructureSection(ReportSection):
    """Picture of the structure, for one or several tests."""

    anchor = "structure"
    name = "Structure"
    heading = "Structure as a picture"
    place = 15

    def applies(self, content: PageContent) -> bool:
        """Whether the page shows an update, or a model before one."""
        return content.update is not None or content.start is not None

    def body(self, content: PageContent, figures: Mapping[str, Figure]) -> str:
        """Return picture and legend; empty if no model has a geometry to draw."""
        if content.start is None:
            return structure_of(list(content.tests.values()))
        if not _is_drawn(content.start.model):
            return ""
        responses, references = sensors_of([content.start.data])
        about = "Sensors and forces."
        return picture(content.start.model, responses, references, {}, about=about)


STRUCTURE = StructureSection()


def structure_of(results: Sequence[UpdateResult]) -> str:
    """Return picture and legend of a structure with all sensors; empty without a geometry."""
    # The model with the most degrees of freedom is drawn.
    result = _find_largest(results)
    if result is None:
        return ""
    responses, references = sensors_of([one.data for one in results])
    changes = _GroupChanges.of(result)
    return picture(
        result.start,
        responses,
        references,
        changes.parts(),
        about=_ABOUT,
        scale=changes.scale(),
        legend=changes.legend(),
        note="No unknown scales a part, so no part is coloured.",
    )


def _find_largest(results: Sequence[UpdateResult]) -> UpdateResult | None:
    """Return the result with the largest model that has a geometry, or None."""
    drawn = [r for r in results if _is_drawn(r.start)]
    return max(drawn, key=lambda r: r.start.n_dofs, default=None)


def _is_drawn(model: Model) -> bool:
    return model.geometry is not None and len(model.geometry.nodes) > 0


def _scene(content: PageContent) -> Scene | None:
    """Return the scene of the viewer; None if no model has a geometry to draw."""
    if content.start is not None:
        model, data = content.start.model, content.start.data
        return scene_of(content, {"start": model}, [data], [], content.start.title, moves=True)
    results = list(content.tests.values())
    result = _find_largest(results)
    if result is None:
        return None
    change = _GroupChanges.of(result).make_colouring(list(result.start.groups))
    colourings = [one for one in (change, colour_by_std(result)) if one is not None]
    return scene_of(
        content,
        {"updated": result.model, "start": result.parameters.at_start(result.start)},
        [one.data for one in results],
        colourings,
        result.title,
        moves=content.has_one_test and result.status != "stopped",
    )


@dataclass(frozen=True, slots=True, eq=False)
class _GroupChanges:
    """The change of each group with its remark and colour."""

    changes: Mapping[str, tuple[str, float]]
    remarks: Mapping[str, str]
    reach: float

    @classmethod
    def of(cls, result: UpdateResult) -> _GroupChanges:
        changes, remarks = group_changes(result), group_remarks(result)
        logs = [abs(math.log(changes[name][1])) for name in changes if not remarks[name]]
        return cls(changes, remarks, max([_LEAST, *logs]))

    def parts(self) -> dict[str, tuple[str, str]]:
        return {name: (self._colour(name), self._title(name)) for name in self.changes}

    def _colour(self, name: str) -> str:
        """Return the CSS class of a group: s-4 to s4, or s0 for a group with a remark."""
        if self.remarks[name]:
            return "s0"
        return f"s{_step(math.log(self.changes[name][1]), self.reach)}"

    def _title(self, name: str) -> str:
        quantity, factor = self.changes[name]
        text = f"{name}: {quantity_words(quantity)} {format_change(factor)}"
        if self.remarks[name]:
            text += f", {self.remarks[name]}"
        return text

    def scale(self) -> list[tuple[str, str]]:
        """Return CSS class and text of each step of the colour scale."""
        if not self.changes:
            return []
        out = [("s0", "not significant or not determined"), ("s-none", "no unknown")]
        if all(self.remarks.values()):
            return out
        steps = []
        for step in range(-STEPS, STEPS + 1):
            if step:
                text = format_change(math.exp(self.reach * step / STEPS), 2)
                steps.append((f"s{step}", text))
        return steps + out

    def make_colouring(self, groups: Sequence[str]) -> Colouring:
        """Return the colouring of the viewer: significant changes on a scale, with labels."""
        titles = {name: self._title(name) for name in self.changes}
        significant = {name for name in self.changes if not self.remarks[name]}
        steps = []
        if len(significant) < len(self.changes):
            steps.append(("same", "not significant or not determined"))
        if self.changes and len(self.changes) < len(groups):
            steps.append(("none", "no unknown"))
        scale = None
        if significant:
            factors = [self.changes[g][1] if g in significant else math.nan for g in groups]
            scale = scale_of_changes(factors, self.reach)
        return Colouring(
            "Change",
            "",
            steps,
            [0 if self.remarks.get(name) else -1 for name in groups],
            [titles.get(name, f"{name}: no unknown") for name in groups],
            scale=scale,
            labels=[titles[name] if name in significant else "" for name in groups],
        )

    def legend(self) -> list[tuple[str, str]]:
        """Return CSS class and text of each group, significant and large changes first."""

        def rank(name: str) -> tuple[bool, float]:
            return bool(self.remarks[name]), -abs(math.log(self.changes[name][1]))

        parts = self.parts()
        return [parts[name] for name in sorted(self.changes, key=rank)]


def group_changes(result: UpdateResult) -> dict[str, tuple[str, float]]:
    """Return the change of each group affected by an unknown: quantity and factor."""
    # The factor is on the first of stiffness, mass and viscous damping that is an unknown. Loss
    # factors are not factors and are omitted.
    parameters = result.parameters
    changes = parameters.changes([result.values[name] for name in parameters.names])
    out = {}
    for group, change in changes.items():
        for quantity in ("stiffness", "mass", "viscous"):
            if change.get(quantity, 0.0) > 0.0 and group in result.start.groups:
                out[group] = (quantity, change[quantity])
                break
    return out


def group_remarks(result: UpdateResult) -> dict[str, str]:
    """Return a remark on the change of each group in `group_changes`; empty if significant."""
    # A change is significant if the 95 % interval of an unknown that causes it excludes the start.
    changes = group_changes(result)
    out = dict.fromkeys(changes, "not significant")
    for p in result.parameters:
        for drive in () if p.is_channel else p.acts_on:
            if drive.quantity != changes.get(drive.group, ("",))[0]:
                continue
            if is_significant(result, p):
                out[drive.group] = ""
            elif out[drive.group] and not math.isfinite(result.std[p.name]):
                out[drive.group] = "not determined"
    return out


def _step(log: float, reach: float) -> int:
    """Return the step of the colour scale, never 0 for a significant change."""
    step = int(np.clip(round(log / reach * STEPS), -STEPS, STEPS))
    return step or int(np.sign(log))
