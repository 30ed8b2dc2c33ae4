"""Strains, stresses and other quantities of the updated structure, with uncertainty bands."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from updyn.arrays import ComplexArray, RealArray
from updyn.dofs import Dof, DofSet
from updyn.errors import OptionError
from updyn.frf import check_lines
from updyn.modal import ModeSet
from updyn.model import Model
from updyn.uncertainty.counts import check_level
from updyn.uncertainty.posterior import Posterior
from updyn.uncertainty.prediction import (
    build_predicted,
    find_limits,
    find_model_errors,
    find_test,
    solve_with_slopes,
)
from updyn.uncertainty.restored import estimate_of
from updyn.updating.result import JointResult, UpdateResult, find_result

__all__ = ["RecoveredBand", "Recovery", "predict_recovered"]


@dataclass(frozen=True, slots=True, eq=False)
class Recovery:
    """Quantities that are linear in the displacements, such as strains and stresses at points.

    Attributes
    ----------
    names : tuple of str
        Names of the n quantities, each once.
    dofs : DofSet
        The n_dofs DOFs on which they depend.
    matrix : ndarray of float, shape (n, n_dofs)
        Quantities by displacements in m and rotations in rad.
    unit : str
        Unit of the quantities, for texts.

    Raises
    ------
    OptionError
        If the matrix is not finite, its shape does not fit, or a name occurs twice.

    Examples
    --------
    >>> strain = updyn.Recovery(["bar"], updyn.DofSet(["1:X", "2:X"]), [[-2.0, 2.0]], "m/m")
    >>> strain
    Recovery(1 quantity of 2 DOFs, m/m)
    """

    names: Sequence[str]
    dofs: DofSet
    matrix: RealArray
    unit: str = ""

    def __post_init__(self) -> None:
        given: Any = self.matrix
        names = tuple(self.names)
        matrix = np.array(given.toarray() if sp.issparse(given) else given, dtype=np.float64)
        dofs = self.dofs if isinstance(self.dofs, DofSet) else DofSet(self.dofs)
        if matrix.shape != (len(names), len(dofs)) or not names:
            raise OptionError(
                f"matrix has the shape {matrix.shape}; expected ({len(names)}, {len(dofs)}), a row"
                " for each name and a column for each DOF"
            )
        if not np.isfinite(matrix).all():
            raise OptionError("matrix: expected finite values")
        if len(set(names)) < len(names):
            repeated = next(name for name in names if names.count(name) > 1)
            raise OptionError(f"names: {repeated!r} occurs twice")
        matrix.flags.writeable = False
        for name, value in (("names", names), ("dofs", dofs), ("matrix", matrix)):
            object.__setattr__(self, name, value)

    @classmethod
    def from_modes(
        cls, names: Sequence[str], values: ArrayLike, modes: ModeSet, model: Model, unit: str = ""
    ) -> Recovery:
        """Return the recovery that has given values in the modes of a finite-element program.

        Parameters
        ----------
        names : sequence of str
            Names of the n quantities.
        values : array_like of float, shape (n, n_modes)
            Modal strains or stresses, in the scale of the shapes.
        modes : ModeSet
            Real modes with a shape at each DOF of the model, in any scale.
        model : Model
            Model whose mass projects displacements on the modes.
        unit : str
            Unit of the quantities.

        Returns
        -------
        Recovery
            It is exact for displacements in the span of the modes, and leaves out the part that is
            orthogonal to them: S (Phi^T M Phi)^-1 Phi^T M with the modal values S (mode
            displacement method; Craig & Kurdila, Fundamentals of Structural Dynamics, 2nd ed. 2006,
            section 11.5).

        Raises
        ------
        OptionError
            If the shapes do not fit, are complex or dependent.

        Examples
        --------
        >>> from updyn.demos import chain
        >>> model = chain.build()
        >>> modes = updyn.modes(model, 12)
        >>> strain = modes.shapes.real[1:2] - modes.shapes.real[:1]
        >>> found = updyn.Recovery.from_modes(["first"], strain, modes, model, "m/m")
        >>> found.matrix.round(6)[0, :2].tolist()
        [-1.0, 1.0]
        """
        given = np.asarray(values, dtype=np.float64)
        if given.shape != (len(names), modes.shapes.shape[1]):
            raise OptionError(
                f"values has the shape {given.shape}; expected ({len(names)},"
                f" {modes.shapes.shape[1]}), a row for each name and a column for each mode"
            )
        found = modes.dofs.match(model.dofs, "DOF of the model")
        shapes = modes.shapes[found.index] * found.sign[:, None]
        if shapes.imag.any():
            raise OptionError("modes: expected real shapes, as of an undamped model")
        projected = np.asarray(model.mass @ shapes.real)
        gram = shapes.real.T @ projected
        if np.linalg.matrix_rank(gram) < len(gram):
            raise OptionError("modes: the shapes are dependent; leave out repeated modes")
        return cls(names, model.dofs, given @ np.linalg.solve(gram, projected.T), unit)

    def __repr__(self) -> str:
        count = "1 quantity" if len(self.names) == 1 else f"{len(self.names)} quantities"
        return f"Recovery({count} of {len(self.dofs)} DOFs, {self.unit or 'no unit'})"


@dataclass(frozen=True, slots=True, eq=False)
class RecoveredBand:
    """Recovered quantities per force with their band; arrays of shape (n_f, n, n_references).

    Attributes
    ----------
    freq : ndarray of float, shape (n_f,)
        Lines in Hz.
    names : tuple of str
        Names of the n quantities.
    references : DofSet
        DOFs of the forces.
    unit : str
        Unit of the quantities; values are per N, or per N m for moments.
    level : float
        Share of the probability within the band, at every value by itself.
    values : ndarray of complex
        The quantities of the updated model.
    lower, upper : ndarray of float
        Limits of the magnitude; 0 and inf if it is undetermined.
    std_real, std_imag : ndarray of float
        Standard deviations of real and imaginary part.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> stretch = updyn.Recovery(["stretch"], ["11:X", "12:X"], [[-1.0, 1.0]], "m")
    >>> updyn.predict_recovered(result, [5.0, 6.0], stretch, ["1:X"])
    RecoveredBand(95 %, stretch, 2 lines, 5 to 6 Hz)
    """

    freq: RealArray
    names: tuple[str, ...]
    references: DofSet
    unit: str
    level: float
    values: ComplexArray
    lower: RealArray
    upper: RealArray
    std_real: RealArray
    std_imag: RealArray

    def __repr__(self) -> str:
        span = f"{len(self.freq)} lines, {self.freq[0]:g} to {self.freq[-1]:g} Hz"
        return f"RecoveredBand({100 * self.level:g} %, {', '.join(self.names)}, {span})"


def predict_recovered(
    source: UpdateResult | JointResult,
    freq: ArrayLike,
    recovery: Recovery,
    references: Iterable[str | Dof],
    *,
    level: float = 0.95,
    test: str | None = None,
) -> RecoveredBand:
    """Predict strains, stresses or other recovered quantities per force, with a band.

    Parameters
    ----------
    source : UpdateResult or JointResult
        An update.
    freq : array_like of float, shape (n_f,)
        Lines in Hz, measured or not.
    recovery : Recovery
        The quantities by the displacements of the model.
    references : iterable of str or Dof
        DOFs of the forces, measured or not.
    level : float
        Share of the probability within, between 0 and 1, at every value by itself.
    test : str, optional
        Of several tests, the one whose model is used.

    Returns
    -------
    RecoveredBand

    Raises
    ------
    OptionError
        If an option is not understood.
    DofError
        If a DOF of the recovery or a reference is no DOF of the model.
    SolverError
        If the model cannot be solved at a line.

    Notes
    -----
    The band covers the uncertainty of the unknowns and the errors of the model that the residual
    shows, as that of `updyn.predict` without noise. The matrix itself is taken as exact; it does
    not follow unknowns that act on a stress, such as a modulus.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> stretch = updyn.Recovery(["stretch"], ["11:X", "12:X"], [[-1.0, 1.0]], "m")
    >>> band = updyn.predict_recovered(result, [5.0], stretch, ["1:X"])
    >>> bool(band.lower[0, 0, 0] < abs(band.values[0, 0, 0]) < band.upper[0, 0, 0])
    True
    """
    check_level(level)
    if not isinstance(recovery, Recovery):
        raise OptionError(f"recovery: expected updyn.Recovery(...), found {recovery!r}")
    result, lines, forces = find_result(source, test), check_lines(freq), DofSet(references)
    acts = recovery.matrix.any(axis=0)
    if not acts.any():
        raise OptionError("recovery: the matrix is zero")
    labels = [label for label, used in zip(recovery.dofs.labels, acts, strict=True) if used]
    part = build_predicted(result, lines, labels, forces, "receptance", as_read=False)
    # The responses of a part may be in another order.
    at = {label: k for k, label in enumerate(part.frf.responses.labels)}
    matrix = np.zeros((len(recovery.names), len(at)))
    matrix[:, [at[label] for label in labels]] = recovery.matrix[:, acts]
    x = part.coordinates.to_x(estimate_of(result))
    H, dH = solve_with_slopes(part, x)
    values = np.einsum("ri,fij->frj", matrix, H)
    slopes = np.einsum("ri,kfij->kfrj", matrix, dH)
    posterior, squares = Posterior.of(source), None
    if (errors := find_model_errors(source, posterior)) is not None:
        squares = errors.mean_square(part, x, find_test(source, result), matrix)
    freedom = result.noise.get("degrees_of_freedom")
    found = find_limits(values, slopes, posterior, level, freedom, mean_square=squares)
    return RecoveredBand(
        lines, tuple(recovery.names), part.frf.references, recovery.unit, level, values,
        found.lower, found.upper, found.std_real, found.std_imag,
    )  # fmt: skip
