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
from updyn.errors import ModelError, OptionError, SolverError
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
        )


def respond_at_random(
    model: Model,
    freq: ArrayLike,
    responses: Iterable[str | Dof],
    references: Iterable[str | Dof],
    level: float,
    quantity: str,
    *,
    tier: str | None,
    backend: str | None,
    accuracy: float,
) -> RandomResponse:
    """Return the response to a random force; parameters and errors as `updyn.response`."""
    lines = check_lines(np.atleast_1d(freq) if np.isscalar(freq) else freq)
    _check_options(lines, level)
    power = QUANTITIES[check_force_quantity(quantity)]
    if not model.nonlinear:
        raise ModelError(
            "level: the model has no nonlinear elements; leave it out, as the response is"
            " proportional to the force, or add elements by model.with_elements"
        )
    rows, columns = DofSet(responses), DofSet(references)
    read, forced = model.dofs.match(rows, "response"), model.dofs.match(columns, "reference")
    band = float(lines[0]), float(lines[-1])
    transfer = Transfer.build(
        model,
        read.index,
        forced.index,
        band,
        np.union1d(lines, 0.5 * (lines[1:] + lines[:-1])),
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
            lambda omega, own=own: own.at(omega)[0],
            None if own.static is None else own.static[:, :n],
            np.array(band),
            np.full(2, level**2 / (band[1] - band[0])),
            f"level {level:g}, force at {label}",
        ).solve()
        H, _ = column.at(omega)
        D = motion.dynamic_stiffness(omega)
        q = deform(H[:, :n], D)
        values[:, :, j] = H[:, n:, n] - (H[:, n:, :n] @ (D * q)[..., None])[..., 0]
        found.append(motion)
    values *= read.sign[:, None] * forced.sign
    values *= ((1j * omega) ** power)[:, None, None]
    spread = np.stack([motion.spread for motion in found], axis=2)
    return RandomResponse(
        lines,
        values,
        rows,
        columns,
        quantity,
        float(level),
        tuple(model.nonlinear),
        *spread,
        *(
            np.stack([getattr(motion, name) for motion in found], axis=1)
            for name in ("mean", "stiffness", "damping")
        ),
        transfer.source,
        model.geometry,
    )


def _check_options(lines: RealArray, level: object) -> None:
    if not is_number(level) or not 0.0 < level < np.inf:
        raise OptionError(
            f"level {level!r}: expected the RMS of a random force above 0, in N (N m)",
            key=("level",),
        )
    if len(lines) < 2 or lines[0] <= 0.0:
        raise OptionError(
            "freq: a random force has the band from the first line to the last; expected two lines"
            " or more, above 0 Hz",
            key=("freq",),
        )
