"""A sensor that does not follow the rigid-body motion of a free structure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from updyn.frf import FRF
from updyn.remedy import Remedy
from updyn.updating.judge.causes.rigid_explanation import explain_sensors
from updyn.updating.judge.causes.rigid_motion import RigidMotion
from updyn.updating.judge.causes.rigid_shapes import RigidShapes
from updyn.updating.judge.causes.settings import RIGID_BODY
from updyn.updating.judge.causes.shown import DataFault, Detection

__all__ = ["RigidBody"]


@dataclass(frozen=True, slots=True)
class RigidBody(DataFault):
    """Sensors differ from rigid-body motion by `value` times the rms motion of all sensors.

    Well below its elastic modes, a free structure moves as a rigid body. The shapes of that motion
    depend on the positions and directions of the sensors alone.
    """

    details: str = ""
    example: str = ""

    kind: ClassVar[str] = "rigid-body"
    odds: ClassVar[float] = 1e-2
    is_symptom: ClassVar[bool] = True
    needs_forces: ClassVar[bool] = True

    @classmethod
    def detect_faults(cls, frf: FRF) -> Iterable[Detection]:
        """Return an empty tuple: the data are compared with the shapes of a model."""
        return ()

    @classmethod
    def detect_in(cls, frf: FRF, rigid: RigidShapes) -> Iterable[Detection]:
        """Yield the sensors that do not follow the rigid-body motion of others, as one fault."""
        alive = [
            dof for dof, one in zip(frf.responses, frf.values.any(axis=(0, 2)), strict=True) if one
        ]
        motion = RigidMotion.of(frf.select(responses=alive), rigid)
        sets = _find_simplest(motion) if motion is not None else []
        if motion is None or not sets:
            return
        wrong = sorted({i for one in sets for i in one})
        details, example = _describe(motion, sets)
        value = max(motion.measure_difference(i, one) for one in sets for i in one)
        square = float(motion.deviations(motion.leave_out([])).max()) ** 2
        log_odds = square - 1.0 - float(np.log(square)) + float(np.log(cls.odds))
        fault = cls(tuple(str(motion.sensors[i]) for i in wrong), value, details, example)
        yield Detection(fault, log_odds, len(sets[0]) / len(frf.responses))

    @property
    def remedy(self) -> Remedy:
        """Advice to the user."""
        advice = f"Look at position, direction, sign and sensitivity of {self.channel_text}."
        if not self.example:
            return Remedy(advice)
        return Remedy.repair(f"{advice} If an explanation is right, write it:", self.example)

    def statement(self) -> str:
        """Return a sentence with the sensors, their difference, and possible causes."""
        return (
            f"{self.begin_sentence('does', 'do')} not follow the rigid-body motion of the other"
            f" sensors: the difference is {100.0 * self.value:.0f} % of the rms motion"
            f"{self.details}"
        )


def _find_simplest(motion: RigidMotion) -> list[tuple[int, ...]]:
    """Return the likeliest sets of wrong sensors; of several, those that simple faults explain."""
    sets = motion.find_wrong()
    if not 1 < len(sets) <= RIGID_BODY.most_compared:
        return sets
    explained = {one: explain_sensors(motion, one) for one in sets}
    simple = [one for one, found in explained.items() if all(found.values())]
    single = [one for one in simple if len(explained[one]) == 1]
    return single or simple or sets


def _describe(motion: RigidMotion, sets: Sequence[Sequence[int]]) -> tuple[str, str]:
    """Return the frequencies and explanations as text, and the first text for a job."""
    freq, example = motion.data.freq, ""
    details = f" at {len(freq)} lines between {freq[0]:.3g} and {freq[-1]:.3g} Hz."
    if len(sets) > 1:
        details += (
            f" The data do not show which are wrong (number of wrong sensors: {len(sets[0])})."
        )
    else:
        for members, found in explain_sensors(motion, sets[0]).items():
            names = " and ".join(str(motion.sensors[i]) for i in members)
            texts = ", or ".join(str(one) for one in found[: RIGID_BODY.named_explanations])
            example = example or next((one.repair_text for one in found if one.repair_text), "")
            if found:
                details += f" What would explain {names}: {texts}."
            else:
                details += f" No sign, factor, direction or other place explains {names}."
    alone = motion.list_unchecked()
    if alone:
        details += f" Not checked, for lack of other sensors: {', '.join(alone)}."
    return details, example
