"""The measured steel beam of the demo, in the form that `faults.py` seeds its faults in.

What was measured takes the place of data with drawn noise, and the answer to it that of the truth.
"""

from __future__ import annotations

import tempfile
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np
import structures

import updyn
from updyn.demos import beam
from updyn.frf import FRF
from updyn.job import load_job
from updyn.job.prepare import prepare
from updyn.model import Model
from updyn.updating.problem.parameters import Parameter, ParameterSet
from updyn.updating.result import UpdateResult

__all__ = ["Measured", "measured_beam"]

#: Of its lines every twentieth, as in the demo.
EVERY = 20
#: How far off starts are, as a share; loss factors start where they are.
SPREAD = {"stiffness": 0.7, "mass": 0.3}


@dataclass(frozen=True, eq=False)
class Measured:
    """A model by its drawings, what was measured, and the kinds of findings that are right."""

    model: Model
    frf: FRF
    known: tuple[str, ...] = ()

    def sought(self, model: Model) -> ParameterSet:
        """Beam and pads, and the mass of the sensors."""
        return updyn.parameters(
            model,
            stiffness=["beam", "pads"],
            mass=["beam", "accelerometers"],
            loss_factor=["beam", "pads"],
        )

    def start(self, rng: np.random.Generator, off: float = 1.0) -> Model:
        """A model that is off by up to `SPREAD` times `off`."""
        changes: dict[str, dict[str, float]] = {}
        for p in self.sought(self.model):
            if p.quantity in SPREAD:
                spread = off * SPREAD[p.quantity]
                factor = 1.0 + rng.uniform(-spread, spread)
                changes.setdefault(p.group, {})[p.quantity] = factor
        return self.model.scaled(changes)

    def turned(self, groups: Collection[str]) -> Model:
        """The model with width and height of the beam exchanged."""
        return drawn(turned=bool(groups))[0]

    @cached_property
    def answer(self) -> UpdateResult:
        """The fit to the data as they were measured, from the drawings."""
        return updyn.update(self.model, self.frf, self.sought(self.model))

    def truth(self, p: Parameter, start: Model) -> float:
        """What that fit says of an unknown of a model."""
        found = self.answer.values[p.name]
        if p.quantity == "loss_factor":
            return found
        sizes = [structures.size(model.group(p.group), p.quantity) for model in (self.model, start)]
        return found * sizes[0] / sizes[1]

    def bound(self, sought: ParameterSet) -> np.ndarray:
        """Standard deviation that it states, as a share (loss factors: as it is), shape (n,)."""
        share = [
            self.answer.std[p.name]
            / (1.0 if p.quantity == "loss_factor" else self.answer.values[p.name])
            for p in sought
        ]
        return np.array(share)


def drawn(*, turned: bool = False) -> tuple[Model, FRF]:
    """The beam of the demo, optionally with exchanged width and height, and its measured FRFs."""
    with tempfile.TemporaryDirectory() as name:
        path = beam.write_inputs(Path(name))
        if turned:
            text = path.read_text(encoding="utf-8")
            exchanged = text.replace("width =", "other =").replace("height =", "width =")
            path.write_text(exchanged.replace("other =", "height ="), encoding="utf-8")
        (test,) = prepare(load_job(path)).tests
    return test.model, test.frf


@cache
def measured_beam() -> Measured:
    """The beam as the demo has it."""
    model, frf = drawn()
    return Measured(model, frf.select(lines=frf.freq[::EVERY]), ("missing-mode",))
