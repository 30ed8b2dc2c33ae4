"""`SharedPlantBasis`: the common basis and options of the plants of a family."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from updyn.arrays import BoolArray
from updyn.control.choice import check_route, choose_route, reuse_selection
from updyn.control.options import check_band, check_error, check_quantities, check_tolerance
from updyn.control.plant import Plant
from updyn.control.ports import Port
from updyn.control.realised import realise
from updyn.control.space import ModalProjection, shared_projection
from updyn.control.spectrum import SpectralDecomposition
from updyn.control.structure import CompiledStructure
from updyn.control.target import CandidateSelection
from updyn.control.task import PlantTask, check_begin, make_task
from updyn.dynamics.affine import State

__all__ = ["SharedPlantBasis"]


@dataclass(frozen=True, slots=True, eq=False)
class SharedPlantBasis:
    """The common basis, ports and options of the plants of a family."""

    projection: ModalProjection
    title: str
    ports: tuple[tuple[Port, ...], tuple[Port, ...]]
    quantities: tuple[str, ...]
    tolerance: float
    error: str

    @classmethod
    def of(
        cls,
        structure: CompiledStructure,
        states: tuple[Sequence[State], Sequence[State]],
        inputs: tuple[Port, ...],
        outputs: tuple[Port, ...],
        band: Sequence[float],
        tolerance: float,
        quantity: str | Sequence[str],
        error: str,
        backend: str | None,
    ) -> tuple[SharedPlantBasis, BoolArray]:
        """Return the common part, and for which of the `states` the basis is accurate."""
        check_error(error)
        check_tolerance(tolerance)
        limits, quantities = check_band(band), check_quantities(quantity, len(outputs))
        projection, holds = shared_projection(
            structure, inputs, outputs, limits, *states, backend=backend
        )
        ports = inputs, outputs
        return cls(projection, structure.model.title, ports, quantities, tolerance, error), holds

    def member(
        self, state: State, route: str, like: CandidateSelection | None = None
    ) -> tuple[Plant, CandidateSelection]:
        """Return the plant of a state, and its selection; the selection `like` is tried first."""
        task = self._task(state)
        found = None if like is None else reuse_selection(task, like, self.tolerance)
        if found is None or not found.holds:
            found = choose_route(task, check_route(route, task, self.error), self.tolerance)
        return realise(task, found, self.title, self.quantities, self.tolerance), found

    def _task(self, state: State) -> PlantTask:
        space = self.projection.space(state)
        check_begin(space, self.projection.band[0])
        spectrum = SpectralDecomposition.of(self.projection, state)
        return make_task(
            self.ports,
            self.quantities,
            space,
            (spectrum.poles, lambda: spectrum),
            self.projection.band,
            self.error,
            spectrum.receptance,
        )
