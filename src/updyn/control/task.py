"""`PlantTask`: the model of a plant, and its target."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from updyn.arrays import BoolArray, ComplexArray, IndexArray, RealArray
from updyn.control.causal import channel_differences, error_lower_bound
from updyn.control.complex_modes import ComplexModes, complex_modes, fit_outputs, slow_motion
from updyn.control.options import check_band, check_quantities
from updyn.control.passivity import collocated_channels
from updyn.control.ports import Port
from updyn.control.rational import SlowMotion
from updyn.control.rational_fit import Approximation
from updyn.control.real_modes import (
    biot,
    diagonal_damping_modes,
    full_damping_modes,
    single_frequency_modes,
)
from updyn.control.settings import COMPLEX_MODES, REAL_MODES
from updyn.control.space import (
    Conversion,
    ModalSpace,
    derivative_factors,
    laplace_variable,
    projection,
)
from updyn.control.spectrum import SpectralDecomposition
from updyn.control.structure import CompiledStructure
from updyn.control.target import (
    CandidateSelection,
    ResponseTarget,
    receptance_function,
    target_lines,
)
from updyn.errors import ModelError, OptionError, SolverError
from updyn.frf import QUANTITIES

__all__ = ["PlantTask", "build_task", "check_begin", "make_task"]


@dataclass(frozen=True, slots=True, eq=False)
class PlantTask:
    """The modes and ports to realise as a plant, and the target response."""

    space: ModalSpace
    target: ResponseTarget
    powers: IndexArray
    band: tuple[float, float]
    ports: tuple[tuple[Port, ...], tuple[Port, ...]]
    spectrum: Callable[[], SpectralDecomposition]

    def least(self, found: CandidateSelection) -> float:
        """Return a lower bound on the error of any stable plant, see `updyn.control.causal`."""
        if not self.space.lossy:  # dampers are causal
            return 0.0
        target = self.target
        level = np.broadcast_to(target.level, target.reference.shape)
        if target.measure == "relative":
            level = target.reference

        spectrum = self.spectrum()

        def structure(lines: RealArray) -> ComplexArray:
            return np.asarray(
                spectrum.receptance(lines)
                * derivative_factors(self.powers, laplace_variable(lines))
            )

        growth = (2 - self.powers) * (self.space.rigid > 0)
        channels = channel_differences(
            target.freq,
            structure,
            level,
            found,
            full_damping_modes(self.space, self.powers),
            growth,
        )
        least = 0.0
        for channel in channels:
            least = error_lower_bound(channel, self.band, least)
        return least

    def approximation(self) -> Approximation:
        """Return the start of a rational approximation: the poles by decreasing importance."""
        inputs, outputs = self.ports
        modes = complex_modes(self.space, self.powers, self.band[1])
        costs = modes.costs(self.target.freq, self.target.reference)
        order = np.argsort(-costs, kind="stable")
        # A servo closes its loop through slow motion, which is therefore kept exactly.
        below = modes.frequency < self.band[0]
        slow = SlowMotion(*slow_motion(self.space))
        if below.any():
            slow = _with_modes(slow, modes, below)
        poles = modes.poles[order[~below[order]]]
        return Approximation(
            self.target, slow, self.powers, poles, collocated_channels(outputs, inputs)
        )

    def conversion(self, route: str, terms: int = 4) -> Conversion:
        """Return a conversion of the structure's modes; `terms` is the length of a Biot series."""
        if route == "modal":
            return full_damping_modes(self.space, self.powers)
        if route == "complex":
            return complex_modes(self.space, self.powers, self.band[1])
        if route == "biot":
            return biot(self.space, full_damping_modes(self.space, self.powers), self.band, terms)
        if route == "diagonal":
            return diagonal_damping_modes(self.space, self.powers)
        return single_frequency_modes(
            self.space, self.powers, float(np.sqrt(self._low * self.band[1]))
        )

    @property
    def _low(self) -> float:
        return max(self.band[0], 1e-3 * self.band[1])

    def conversions(self, route: str) -> Iterator[Conversion]:
        """Yield the conversions of a route by increasing cost."""
        for terms in REAL_MODES.relaxation_terms if route == "biot" else (0,):
            yield self.conversion(route, terms)

    def fitted_conversions(self, route: str) -> Iterator[Conversion]:
        """Yield the conversions of a route, then fitted ones."""
        # Those whose velocities are not 0 at rest are last: the constraint may leave too few
        # degrees of freedom with many inputs and few modes.
        for conversion in self.conversions(route):
            yield conversion
            if isinstance(conversion, ComplexModes):
                for at_rest in (True, False):
                    if at_rest or (conversion.is_supported and self.powers.any()):
                        for n in COMPLEX_MODES.real_poles:
                            yield fit_outputs(conversion, self.target, n, at_rest=at_rest)


def _with_modes(slow: SlowMotion, modes: ComplexModes, kept: BoolArray) -> SlowMotion:
    A, B = modes.blocks(kept, modes.at_inputs[:, kept])
    left = 2.0 * modes.at_outputs[:, kept]
    pairs = np.stack([left.real, left.imag], axis=2).reshape(len(left), -1)
    displacements = np.hstack([slow.displacements, pairs])
    return SlowMotion(A, B, displacements, slow.velocities, modes.frequency[kept])


def build_task(
    structure: CompiledStructure,
    inputs: tuple[Port, ...],
    outputs: tuple[Port, ...],
    band: Sequence[float],
    quantity: str | Sequence[str],
    tier: str | None,
    backend: str | None,
    measure: str = "relative",
) -> tuple[PlantTask, tuple[str, ...]]:
    """Return the task of a structure, and the quantity of each output; as for `updyn.plant`."""
    limits = check_band(band)
    quantities = check_quantities(quantity, len(outputs))
    system = structure.system
    found = projection(structure, inputs, outputs, limits, backend=backend)
    space = found.space(system.start)
    check_begin(space, limits[0])
    ports = inputs, outputs
    answer = receptance_function(structure.model, *ports, space.solver, tier, backend)
    task = make_task(
        ports,
        quantities,
        space,
        (_poles(space), lambda: SpectralDecomposition.of(found, system.start)),
        limits,
        measure,
        answer,
    )
    return task, quantities


def check_begin(space: ModalSpace, low: float) -> None:
    """Raise OptionError if a band starts at 0 Hz and the structure has rigid-body motion."""
    if space.rigid and low == 0.0:
        raise OptionError(
            f"plant: the band starts at 0 Hz, where the {space.rigid} rigid-body motions of the"
            " structure have no finite response; start it above 0 Hz"
        )


def make_task(
    ports: tuple[tuple[Port, ...], tuple[Port, ...]],
    quantities: tuple[str, ...],
    space: ModalSpace,
    damped: tuple[ComplexArray, Callable[[], SpectralDecomposition]],
    band: tuple[float, float],
    measure: str,
    receptance: Callable[[RealArray], ComplexArray],
) -> PlantTask:
    """Return the task with the response at lines that resolve it.

    `damped` are the poles of the damped structure in rad/s and a function that returns its
    spectrum.
    """
    powers = np.array([QUANTITIES[q] for q in quantities], dtype=np.intp)
    target = ResponseTarget.of(
        receptance,
        quantities,
        target_lines(damped[0], band),
        slow=bool(space.omega[0] < 2.0 * np.pi * band[0]),
        potential=full_damping_modes(space, powers).potential,
        measure=measure,
        reduced=space.solver is not None,
    )
    if not np.isfinite(target.values).all():
        raise SolverError(
            "plant: the structure has no finite response at a line of the band: it is not damped"
        )
    return PlantTask(space, target, powers, band, ports, damped[1])


def _poles(space: ModalSpace) -> ComplexArray:
    """Return the poles of the damped structure; if defective, those of its separate modes."""
    try:
        return complex_modes(space, np.zeros(len(space.outputs), dtype=np.intp), 1.0).poles
    except ModelError:
        return np.asarray(space.omega * (1j - 0.5 * space.loss_factors()))
