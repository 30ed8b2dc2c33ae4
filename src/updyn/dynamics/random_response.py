"""`respond_at_random`: FRFs of a model with nonlinear elements under a random force.

The motion of the elements is that of `updyn.dynamics.linearisation`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.dynamics.linearisation import Linearisation, deform
from updyn.dynamics.periodic.transfer import Transfer
from updyn.dynamics.settings import RANDOM
from updyn.errors import ModelError, OptionError, SolverError
from updyn.force_spectrum import check_spectrum, find_rms, make_flat_spectrum
from updyn.frf import FRF, QUANTITIES, check_force_quantity, check_lines
from updyn.geometry import Geometry
from updyn.group import is_number
from updyn.model import Model

__all__ = ["RandomResponse", "respond_at_random"]


@dataclass(frozen=True, slots=True, eq=False)
class RandomResponse:
    """Response of a model with nonlinear elements to one random force after another.

    Parameters
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines in Hz.
    values : ndarray of complex, shape (n_f, n_responses, n_references)
        FRFs of the linearised model, in m/N, m/s/N or m/s2/N.
    responses, references : DofSet
        Signed DOFs of sensors and forces.
    quantity : str
        ``"receptance"``, ``"mobility"`` or ``"accelerance"``.
    level : float
        RMS of the force in N (N m).
    spectrum : ndarray of float, shape (n_s, 2)
        Frequencies in Hz and one-sided power spectral density of the force in N^2/Hz.
    elements : tuple of str
        Names of the nonlinear elements.
    deformation, velocity : ndarray of float, shape (n_e, n_references)
        Standard deviations of the deformation of each element in m (rad) and of its velocity in m/s
        (rad/s), for each force.
    mean : ndarray of float, shape (n_e, n_references)
        Mean deformation in m (rad); 0 if all elements are odd.
    stiffness, damping : ndarray of float, shape (n_e, n_references)
        Equivalent stiffness in N/m (N m/rad) and damping in N s/m (N m s/rad) of each element.
    source : str
        Kind of the linear model, and its error if it is reduced.
    geometry : Geometry, optional
        Positions of the nodes.

    Examples
    --------
    >>> import numpy as np
    >>> from updyn.demos import chain
    >>> model = chain.build().with_elements({"stop": (updyn.CubicSpring(1e9), "12:X")})
    >>> options = {"level": 5.0, "excitation": "random"}
    >>> found = updyn.response(model, np.linspace(0.5, 20.0, 40), ["12:X"], ["12:X"], **options)
    >>> bool(np.allclose(found.stiffness, 3e9 * found.deformation**2))
    True
    """

    freq: RealArray
    values: ComplexArray
    responses: DofSet
    references: DofSet
    quantity: str
    level: float
    spectrum: RealArray
    elements: tuple[str, ...]
    deformation: RealArray
    velocity: RealArray
    mean: RealArray
    stiffness: RealArray
    damping: RealArray
    source: str
    geometry: Geometry | None = None

    @property
    def frf(self) -> FRF:
        """The FRFs of the linearised model, with the level of the force."""
        return FRF(
            self.freq,
            self.values,
            self.responses,
            self.references,
            self.quantity,
            geometry=self.geometry,
            source=f"{self.source}, random force {self.level:g}",
            level=self.level,
            excitation="random",
            spectrum=self.spectrum,
        )


def respond_at_random(
    model: Model,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    level: float | None,
    spectrum: ArrayLike | None,
    quantity: str,
    *,
    tier: str | None,
    backend: str | None,
    accuracy: float,
) -> RandomResponse:
    """Return the response to a random force; parameters and errors as `updyn.response`."""
    lines = check_lines(np.atleast_1d(freq) if np.isscalar(freq) else freq)
    force = _find_spectrum(lines, level, spectrum)
    power = QUANTITIES[check_force_quantity(quantity)]
    if not model.nonlinear:
        raise ModelError(
            "level: the model has no nonlinear elements; leave it out, as the response is"
            " proportional to the force, or add elements by model.with_elements"
        )
    rows, columns = DofSet(responses), DofSet(references)
    read, forced = model.dofs.match(rows, "response"), model.dofs.match(columns, "reference")
    band = float(force[0, 0]), float(force[-1, 0])
    transfer = Transfer.build(
        model,
        read.index,
        forced.index,
        band,
        np.union1d(lines, np.linspace(*band, 1 + RANDOM.reduced_lines)[1:]),
        tier=tier,
        backend=backend,
        accuracy=accuracy,
    )
    elements = [local.element for local in model.nonlinear.values()]
    if transfer.static is None and not all(element.is_odd for element in elements):
        raise SolverError(
            "level: the model is free at 0 Hz and an element is not odd, so that the mean of the"
            " motion is not determined; hold the model by a spring"
        )
    n, omega = len(elements), 2.0 * np.pi * lines
    values = np.empty((len(lines), len(rows), len(columns)), dtype=np.complex128)
    found = []
    for j, label in enumerate(columns.labels):
        column = transfer.select(j, n)
        own = column.keep_outputs(n)
        motion = Linearisation(
            elements,
            own.respond,
            None if own.static is None else own.static[:, :n],
            force[:, 0],
            force[:, 1],
            f"level {find_rms(force):g} random, force at {label}",
        ).solve()
        H, _ = column.at(omega)
        D = motion.dynamic_stiffness(omega)
        q = deform(H[:, :n], D)
        values[:, :, j] = H[:, n:, n] - (H[:, n:, :n] @ (D * q)[..., None])[..., 0]
        found.append(motion)
    values *= read.sign[:, None] * forced.sign
    values *= ((1j * omega) ** power)[:, None, None]

    def stack(arrays: Iterable[RealArray]) -> RealArray:
        return np.stack(list(arrays), axis=1)

    return RandomResponse(
        lines,
        values,
        rows,
        columns,
        quantity,
        find_rms(force),
        force,
        tuple(model.nonlinear),
        stack(motion.spread[0] for motion in found),
        stack(motion.spread[1] for motion in found),
        stack(motion.mean for motion in found),
        stack(motion.stiffness for motion in found),
        stack(motion.damping for motion in found),
        transfer.source,
        model.geometry,
    )


def _find_spectrum(lines: RealArray, level: object, spectrum: ArrayLike | None) -> RealArray:
    """Return the spectrum of the force, (n_s, 2); by default constant over the lines."""
    if spectrum is not None:
        if level is not None:
            raise OptionError(
                "level and spectrum are stated; expected one of the two", key=("spectrum",)
            )
        return check_spectrum(spectrum)
    if not is_number(level) or not 0.0 < level < np.inf:
        raise OptionError(
            f"level {level!r}: expected the RMS of a random force above 0, in N (N m)",
            key=("level",),
        )
    if len(lines) < 2 or lines[0] <= 0.0:
        raise OptionError(
            "freq: a random force has the band from the first line to the last; expected two lines"
            " or more, above 0 Hz, or spectrum=",
            key=("freq",),
        )
    return make_flat_spectrum((float(lines[0]), float(lines[-1])), float(level))
