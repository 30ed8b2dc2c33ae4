"""Natural frequencies, loss factors and mode shapes, real or complex.

Mass and stiffness may both be singular, but not for the same motion: all solutions use the definite
pencil with a negative shift, K + s M with s > 0.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from updyn.arrays import NumberArray, RealArray
from updyn.dofs import Dof, DofSet, positions
from updyn.dynamics import eigen
from updyn.dynamics.settings import EIGEN
from updyn.errors import DataError, ModelError, SolverError, UpdynWarning
from updyn.model import Matrix, Model
from updyn.notebook import card, table

__all__ = ["Modes", "complex_modes_of", "modes", "modes_up_to"]


# A stiffness energy below this share of the sum of its absolute terms is zero within rounding.
_ZERO = 1e3 * np.finfo(np.float64).eps
_TWO_PI = 2.0 * np.pi


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """Modes of a model, by ascending frequency.

    Attributes
    ----------
    frequency : ndarray of float, shape (n,)
        Natural frequencies in Hz. For complex modes the square root of the real part of lambda =
        omega^2 (1 + i eta). A rigid-body mode has exactly 0.
    loss_factor : ndarray of float, shape (n,)
        Modal loss factor eta; twice the damping ratio for light damping. A rigid-body mode has 0,
        because it stores no energy.
    shapes : ndarray of float or complex, shape (N, n)
        Mode shapes as columns, normalised to phi^T M phi = 1 (transpose, not conjugate), in
        1/sqrt(kg) for translations; the largest component is (in its real part) positive.
    dofs : DofSet
        The N DOFs of the rows.
    """

    frequency: RealArray
    loss_factor: RealArray
    shapes: NumberArray
    dofs: DofSet

    def __len__(self) -> int:
        return len(self.frequency)

    def __repr__(self) -> str:
        shown = [f"{f:.6g}" for f in self.frequency[:6]]
        if len(self) > 6:
            shown.append("...")
        return f"Modes({len(self)} modes: {', '.join(shown)} Hz)"

    def _repr_html_(self) -> str:
        rows = [
            [str(k + 1), f"{frequency:.6g}", f"{loss:.4g}"]
            for k, (frequency, loss) in enumerate(
                zip(self.frequency.tolist(), self.loss_factor.tolist(), strict=True)
            )
        ]
        facts = {"modes": len(self), "DOFs": len(self.dofs)}
        return card("Modes", facts, table(("mode", "frequency (Hz)", "loss factor"), rows))

    def at(self, dofs: Iterable[str | Dof]) -> NumberArray:
        """Return the shapes at signed DOFs, shape (k, n); DofError if one is not in the model."""
        match = self.dofs.match(DofSet(dofs))
        return np.asarray(self.shapes[match.index] * match.sign[:, None])

    def select(self, which: ArrayLike) -> Modes:
        """Return modes by numbers from 0 (in this order, each once) or by a flag for each."""
        at = positions(which, len(self), "modes", DataError)
        return Modes(self.frequency[at], self.loss_factor[at], self.shapes[:, at], self.dofs)


def modes(model: Model, n: int, *, complex: bool = False) -> Modes:
    """Compute the lowest modes of a model.

    Parameters
    ----------
    model : Model
        The structure, with all its damping.
    n : int
        Number of modes, lowest first, rigid-body modes included.
    complex : bool
        False: undamped modes, K phi = omega^2 M phi, with the loss factor by modal strain energy.
        True: modes of the damped structure, (K + i D) phi = omega^2 (1 + i eta) M phi, or with
        viscous damping those of s^2 M + s C + K + i D with lambda = -s^2. A loss factor with a
        table is evaluated at the frequency of each mode; complex modes do not permit tables.

    Returns
    -------
    Modes

    Raises
    ------
    ModelError
        If `n` is not a number of modes that the model has (the message contains their number), the
        model is too large for complex modes with viscous damping, a mode is outside the table of a
        loss factor, or complex modes are requested with such a table.
    SolverError
        If a motion has neither stiffness nor mass, or the eigenvalue solver fails.

    Warns
    -----
    UpdynWarning
        If the stiffness is indefinite, so that omega^2 of a mode is negative; its frequency is then
        given as 0.

    Notes
    -----
    Modal strain energy: eta = (phi^T D phi + omega phi^T C phi) / phi^T K phi (Johnson & Kienholz,
    AIAA Journal 20 (1982) 1284-1290, eq. 8, for the structural part; the viscous part is the energy
    loss per cycle at the frequency of the mode). Complex modes: Ewins, Modal Testing, 2nd ed. 2000,
    sections 2.5 and 2.7.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> updyn.modes(chain.build(), 3).frequency.round(2)
    array([ 2.16,  6.43, 10.39])
    """
    _check_count(n, model.mass)
    result = _real(model, lambda K, M: eigen.real_pairs(K, M, n))
    if complex:
        return complex_modes_of(model, result)
    return result


def modes_up_to(model: Model, highest: float, most: int) -> Modes:
    """Return the undamped modes up to a frequency in Hz and one above, `most` modes at most."""
    most, value = min(eigen.mass_rank(model.mass), most), (_TWO_PI * highest) ** 2
    return _real(model, lambda K, M: eigen.pairs_up_to(K, M, value, most))


def _check_count(n: int, M: Matrix) -> None:
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise ModelError(f"modes: n = {n!r}; expected a whole number of at least 1")
    finite = eigen.mass_rank(M)
    if n > finite:
        massless = M.shape[0] - finite
        raise ModelError(
            f"{n} modes asked for; the model has {finite}: {M.shape[0]} DOFs, of which {massless}"
            " combinations carry no mass"
        )


def _real(model: Model, solve: Callable[[Matrix, Matrix], eigen.Pairs]) -> Modes:
    """Return the undamped modes that `solve` finds, with loss factors by modal strain energy."""
    model.refuse_nonlinear("modes")
    K, M = model.stiffness, model.mass
    try:
        value, shapes = solve(K, M)
    except SolverError as error:
        raise SolverError(f"{error}{_motion_without_either(model, K, M)}") from error
    shapes = shapes / np.sqrt(np.einsum("in,in->n", shapes, M @ shapes))
    energy = np.einsum("in,in->n", shapes, K @ shapes)
    noise = _ZERO * np.einsum("in,in->n", np.abs(shapes), abs(K) @ np.abs(shapes))
    rigid = np.abs(energy) <= noise
    unstable = ~rigid & (energy < 0)
    if unstable.any():
        worst = float(value[unstable].min())
        warnings.warn(
            f"{int(unstable.sum())} mode(s) with negative omega^2 (down to {worst:.3g} 1/s2): the"
            " stiffness is indefinite; their frequency is given as 0 Hz",
            UpdynWarning,
            stacklevel=3,
        )
    elastic = ~rigid & ~unstable
    omega = np.sqrt(np.where(elastic, value, 0.0))
    lost = _structural_energy(model, shapes, omega / _TWO_PI)
    lost = lost + omega * np.einsum("in,in->n", shapes, model.viscous @ shapes)
    loss = np.divide(lost, energy, out=np.zeros_like(lost), where=elastic)
    order = np.argsort(omega, kind="stable")
    return _pack(omega[order], loss[order], shapes[:, order], model.dofs)


def _structural_energy(model: Model, shapes: RealArray, freq: RealArray) -> RealArray:
    """Return phi^T D phi of each mode at its frequency; it is 0 for a rigid-body mode."""
    lost = np.zeros(shapes.shape[1])
    for name, group in model.groups.items():
        if group.stiffness is not None and group.loss_factor:
            loss = np.zeros(len(freq))
            for i in np.flatnonzero(freq > 0):
                loss[i] = group.loss_at(float(freq[i]), name)
            lost += loss * np.einsum("in,in->n", shapes, group.stiffness @ shapes)
    return lost


def _motion_without_either(model: Model, K: Matrix, M: Matrix) -> str:
    """Return text on the DOF that moves most without stiffness and mass; empty for large models."""
    if K.shape[0] > EIGEN.dense_dofs:
        return ""
    dof = model.dofs[eigen.weakest_dof(K, M)]
    return f"; it moves DOF {dof} most"


def complex_modes_of(model: Model, real: Modes) -> Modes:
    """Return as many complex modes as `real`, from which undamped rigid-body modes are copied."""
    K, M, n = model.stiffness, model.mass, len(real)
    for name, group in model.groups.items():
        if group.loss_table is not None:
            raise ModelError(
                f"group {name!r}: its loss factor depends on frequency, and complex modes need one"
                " number; use complex=False, which takes it at each mode's own frequency"
            )
    C, D = model.viscous, model.structural
    viscous = C.nnz > 0
    still = real.frequency == 0.0
    if viscous:
        strength = np.einsum("in,in->n", real.shapes, C @ real.shapes)
        noise = _ZERO * np.einsum("in,in->n", np.abs(real.shapes), abs(C) @ np.abs(real.shapes))
        still = still & (strength <= noise)
    rigid = np.flatnonzero(still)
    rest = n - len(rigid)
    scale = max(float(real.frequency[-1]) * _TWO_PI, 1.0)
    stiffness = K + 1j * D
    if rest == 0:
        value = np.zeros(0, dtype=np.complex128)
        shapes = np.zeros((K.shape[0], 0), dtype=np.complex128)
    elif viscous:
        most = EIGEN.dense_dofs // 2  # the state has two entries for each DOF
        if K.shape[0] > most:
            raise ModelError(
                "complex modes with viscous damping are computed in state space, for at most"
                f" {most} DOFs; the model has {K.shape[0]}. Use complex=False, or"
                " give the damping as loss factors"
            )
        value, shapes = eigen.state_space_pairs(stiffness, C, M, scale)
    else:
        value, shapes = eigen.complex_pairs(stiffness, M, n, scale)
    # Other rigid-body modes are found by their size and replaced by the exact ones.
    moving = np.flatnonzero(value.real > 1e-10 * scale**2)
    moving = moving[np.argsort(value.real[moving], kind="stable")]
    if len(moving) < rest:
        raise ModelError(
            f"{n} complex modes asked for; the model has {len(rigid) + len(moving)} that oscillate"
            " or are rigid-body modes: the others are damped beyond oscillation or carry no mass"
        )
    value, shapes = value[moving[:rest]], shapes[:, moving[:rest]]
    shapes = shapes / np.sqrt(np.einsum("in,in->n", shapes, M @ shapes))
    omega = np.concatenate([np.zeros(len(rigid)), np.sqrt(value.real)])
    loss = np.concatenate([np.zeros(len(rigid)), value.imag / value.real])
    return _pack(omega, loss, np.hstack([real.shapes[:, rigid], shapes]), model.dofs)


def _pack(omega: RealArray, loss: RealArray, shapes: NumberArray, dofs: DofSet) -> Modes:
    largest = shapes[np.argmax(np.abs(shapes), axis=0), np.arange(shapes.shape[1])]
    shapes = shapes * np.where(largest.real < 0, -1.0, 1.0)
    frequency = omega / _TWO_PI
    for array in (frequency, loss, shapes):
        array.flags.writeable = False
    return Modes(frequency, loss, shapes, dofs)
