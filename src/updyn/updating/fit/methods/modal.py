"""Modal sensitivity method: natural frequencies and mode shapes, as in most updating programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from updyn.arrays import RealArray
from updyn.errors import OptionError, ParameterError, suggest
from updyn.group import GROUP_QUANTITIES
from updyn.modal import ModeSet, identify_modes
from updyn.updating.fit.method import Fit, Method, descend_to_scale
from updyn.updating.fit.monitor import Monitor
from updyn.updating.fit.trust_region import TrustRegion
from updyn.updating.problem.local import Local, join_locals
from updyn.updating.problem.modal import ModalError, ModalPart, ModalTarget, check_any_pair
from updyn.updating.problem.noise import NoiseModel
from updyn.updating.problem.noise.modes import ASSUMED_OF_MODES, ModalNoise
from updyn.updating.problem.parameters import CHANNELS
from updyn.updating.problem.problem import FRFPart, Problem
from updyn.updating.problem.residuals import OutputErrorSet
from updyn.updating.problem.session import Stopped

__all__ = ["ADVICE", "ModalMethod"]


ADVICE = (
    "Modes show stiffness and mass against each other: hold one, or give a prior; use more modes,"
    " or sensors that tell their shapes; or fit the FRFs with the default method, whose level shows"
    " both."
)


@dataclass(frozen=True, slots=True)
class ModalMethod(Method):
    """Frequencies and shapes of paired modes, by exact sensitivities (method ``"modal"``).

    R. L. Fox & M. P. Kapoor, AIAA J. 6 (1968) 2426 (eigenvalues); R. B. Nelson, AIAA J. 14 (1976)
    1201 (eigenvectors); J. E. Mottershead, M. Link & M. I. Friswell, "The sensitivity method in
    finite element model updating: a tutorial", Mech. Syst. Signal Process. 25 (2011) 2275-2296
    (residuals, weights, pairing). In every step, undamped modes are paired anew by MAC; no damping
    and no level of the FRFs is used.

    The lowest `n_modes` are fitted; 0: all. `shape_weight` weighs the error of a shape, a share of
    its rms, against that of a frequency: shapes are ten times less accurate (Friswell &
    Mottershead, Finite Element Model Updating in Structural Dynamics, 1995). `mac_residual`
    compares a shape by its MAC alone, r = (1 - sqrt(MAC)) / sqrt(MAC) (Moller & Friberg 1998).
    Modes with a MAC below `mac` for every mode of the model are omitted. `modes`, for several tests
    by name, are by default identified.
    """

    max_iterations: int = 100
    tolerance: float = 1e-10
    n_modes: int = 0
    shapes: bool = True
    shape_weight: float = 0.1
    mac_residual: bool = False
    mac: float = 0.8
    modes: ModeSet | Mapping[str, ModeSet] | None = None

    name: ClassVar[str] = "modal"
    reference: ClassVar[str] = "Fox & Kapoor 1968, Nelson 1976"
    needs: ClassVar[str] = "modes that can be told apart"
    fits_modes: ClassVar[bool] = True
    needs_exact: ClassVar[str] = (
        "tier 'reduced' is accurate near the measured lines only, and 'modal' computes modes; use"
        " tier 'sparse'"
    )
    cannot: ClassVar[tuple[str, ...]] = (
        *(q for q in GROUP_QUANTITIES if q not in ("stiffness", "mass")),
        *CHANNELS,
    )

    def __post_init__(self) -> None:
        if self.shapes and not self.shape_weight > 0:
            raise OptionError(
                "option shape_weight = 0: expected a number above 0; shapes=False leaves shapes"
                " out",
                key=("shape_weight",),
            )
        if self.mac > 1.0:
            raise OptionError(
                f"option mac = {self.mac:g}: expected a number from 0 to 1", key=("mac",)
            )
        mode_sets = self.modes.values() if isinstance(self.modes, Mapping) else [self.modes]
        for one in mode_sets:
            if one is not None and not isinstance(one, ModeSet):
                raise OptionError(
                    f"option modes: expected a ModeSet, found {type(one).__name__}; read one with"
                    " updyn.read_modes, or name the file in a job: [test] modes",
                    key=("modes",),
                )

    def fit(
        self, problem: Problem, noises: Sequence[NoiseModel], monitor: Monitor, x: RealArray
    ) -> Fit:
        """Fit the unknowns from x; the noise of the modes is estimated from the residual.

        Raises ParameterError if an unknown is damping or a calibration factor, DataError if no mode
        is measured or resembles one of the model, OptionError if modes are given for unknown tests,
        and SolverError if modes cannot be computed at x or two paired ones coincide.
        """
        self._check_unknowns(problem)
        self._check_names([part.name for part in problem.parts])
        with monitor.stage(self.name):
            try:
                whole = Problem.of((), self._modal_parts(problem))
                error = ModalError(self._noise, shapes=self.shapes)
                check_any_pair(whole.modal, x, shapes=self.shapes)
                residual = OutputErrorSet((), (error,) * len(whole.modal))
                settings = TrustRegion(self.max_iterations, self.tolerance)
                spread = partial(_spread, whole, error)
                outcome = descend_to_scale(whole, residual, x, monitor, settings, spread)
                x = outcome.x
                local = join_locals([error.local(part, x) for part in whole.modal], problem.n)
                sigma = spread(x)
                records = _records(whole, error, x)
            except Stopped:
                return Fit.without_jacobian(x, "stopped")
        missing = [record["left_out"] for record in records if "left_out" in record]
        note = ""
        if missing:
            omitted = ", ".join(missing)
            note = f"Measured modes that resemble no mode of the model are omitted: {omitted}."
        return Fit(
            x,
            outcome.reason,
            local.R / (sigma if sigma > 0 else 1.0),
            records,
            note,
            advice=ADVICE,
        )

    @property
    def _noise(self) -> ModalNoise:
        """The weights as standard deviations, relative to that of a frequency."""
        added = {"frequency": 1.0}
        if self.shapes:
            added["mac" if self.mac_residual else "shape"] = 1.0 / self.shape_weight
        return ModalNoise(added, frozenset(added), "spread of the modal residuals")

    def _modal_parts(self, problem: Problem) -> list[ModalPart]:
        """Return the modes of each test: those of its FRFs, and those that are data themselves."""
        found = []
        for part in problem.parts:
            target = ModalTarget.of(part.solver.system, self._select_modes(part))
            found.append(
                ModalPart(
                    part.solver.system,
                    part.unknowns,
                    part.coordinates,
                    target,
                    session=part.session,
                    name=part.name,
                )
            )
        for given in problem.modal:
            number = min(self.n_modes or len(given.target.value), len(given.target.value))
            found.append(replace(given, target=given.target.select(range(number))))
        return [replace(part, least_mac=self.mac) for part in found]

    def _check_unknowns(self, problem: Problem) -> None:
        unsupported = []
        for p in problem.coordinates.parameters:
            if any(d.quantity in self.cannot for d in p.acts_on):
                unsupported.append(p.name)
        if unsupported:
            shown = ", ".join(unsupported[:4])
            if len(unsupported) > 4:
                shown += f" and {len(unsupported) - 4} more"
            raise ParameterError(
                "method 'modal': real modes show neither damping nor the level of a channel"
                f" ({shown}); leave these unknowns out, or use a method that fits the FRFs, such as"
                " the default"
            )

    def _check_names(self, names: Sequence[str]) -> None:
        if isinstance(self.modes, ModeSet) and len(names) > 1:
            raise OptionError(
                "option modes: there are several tests; give modes by the name of the test",
                key=("modes",),
            )
        if not isinstance(self.modes, Mapping):
            return
        for name in self.modes:
            if name not in names:
                raise OptionError(
                    f"option modes: no test {name!r}; {suggest(str(name), names)}", key=("modes",)
                )

    def _select_modes(self, part: FRFPart) -> ModeSet:
        modes = self.modes
        if isinstance(modes, Mapping):
            modes = modes.get(part.name)
        if modes is None:
            # The rate is 1 for a viscous matrix, and the coefficient for Rayleigh damping.
            viscous = bool(part.solver.system.start.rate.any())
            modes = identify_modes(part.frf, damping="viscous" if viscous else "structural")
        return modes.select(range(min(self.n_modes or len(modes), len(modes))))


def _spread(problem: Problem, error: ModalError, x: RealArray, local: Local | None = None) -> float:
    """Return the standard deviation of a frequency, or the assumed one for few residuals."""
    squares, count = 0.0, 0
    for part in problem.modal:
        part_squares, number = error.power(part, x)
        squares, count = squares + part_squares, count + number
    if count <= problem.n:
        return ASSUMED_OF_MODES["frequency"]
    return float(np.sqrt(squares / (count - problem.n)))


def _records(problem: Problem, error: ModalError, x: RealArray) -> tuple[Mapping[str, Any], ...]:
    """Return residuals (nan away from all modes) and omitted modes for each test."""
    by_part = [(part, error.rows(part, x)) for part in problem.modal]
    frequency_residuals = np.concatenate([one.r[one.of("frequency")] for _, one in by_part])
    macs = np.concatenate([one.mac[one.mac >= part.least_mac] for part, one in by_part])
    common = {
        "kind": error.noise.kind,
        "modes": float(len(macs)),
        "frequency_rms": float(np.sqrt(np.mean(frequency_residuals**2)))
        if frequency_residuals.size
        else np.nan,
        "shape_rms": float(np.sqrt(np.mean(1.0 - macs))) if macs.size else np.nan,
        "lowest_mac": float(macs.min()) if macs.size else np.nan,
        "chi_square": 1.0,
        "inflation": 1.0,
    }
    return tuple(common | part.record_unpaired(one) for part, one in by_part)
