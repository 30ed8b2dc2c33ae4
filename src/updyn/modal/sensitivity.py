"""Undamped modes of a compiled model and their exact derivatives by the unknowns.

Eigenvalues: R. L. Fox & M. P. Kapoor, "Rates of change of eigenvalues and eigenvectors", AIAA J. 6 (1968) 2426-2429,
eq. 6. Eigenvectors: R. B. Nelson, "Simplified calculation of eigenvector derivatives", AIAA J. 14 (1976) 1201-1205:
from the mode itself and one factorisation, no sum over modes. Wanted at a few DOFs, all derivatives follow from as many
solutions with that factorisation (its matrix is symmetric), however many unknowns there are.

Derivatives of single modes exist where their eigenvalues are distinct. Equal ones only have derivatives as a group, and
none along several unknowns at once.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from updyn.dynamics import eigen
from updyn.dynamics.affine import AffineSystem, State
from updyn.errors import SolverError
from updyn.sensitivity import Unknowns

__all__ = ["RealModes", "slopes"]

_Real = NDArray[np.float64]

#: A strain energy below this share of the sum of its absolute terms is what rounding leaves of none.
_ZERO = 1e3 * np.finfo(np.float64).eps
_ACCURATE = 1e-6
_SINGULAR = "the derivative of a mode shape: another mode has the same eigenvalue"


@dataclass(frozen=True, slots=True, eq=False)
class RealModes:
    """The lowest undamped modes that are no rigid-body motions.

    Attributes
    ----------
    K, M : sparse CSR, shape (N, N), real symmetric
        Stiffness (N/m) and mass (kg) of the model, undamped.
    value : ndarray of float, shape (n,)
        Eigenvalues omega^2 in 1/s2, ascending.
    shapes : ndarray of float, shape (N, n)
        Of unit modal mass.
    n_rigid : int
        Rigid-body motions below them.
    complete : bool
        Whether the model has no more.
    """

    K: Any
    M: Any
    value: _Real
    shapes: _Real
    n_rigid: int
    complete: bool

    @classmethod
    def lowest(cls, system: AffineSystem, state: State, n: int, highest: float) -> RealModes:
        """Compute modes until they are enough.

        Parameters
        ----------
        system : AffineSystem
            The compiled model.
        state : State
            Where.
        n : int
            At least how many, rigid-body motions not counted, as far as the model has them.
        highest : float
            Frequency in Hz that at least one of them exceeds, as far as the model has it.

        Returns
        -------
        RealModes

        Raises
        ------
        SolverError
            If the eigenvalue solver fails.
        """
        K, M = (_matrix(system, state, what) for what in ("stiffness", "mass"))
        finite, limit = eigen.mass_rank(M), (2.0 * np.pi * highest) ** 2
        wanted = min(n + 6, finite)
        while True:
            value, shapes = eigen.real_pairs(K, M, wanted)
            noise = _ZERO * np.einsum("in,in->n", np.abs(shapes), abs(K) @ np.abs(shapes))
            elastic = np.einsum("in,in->n", shapes, K @ shapes) > noise
            if wanted == finite or (elastic.sum() >= n and value[-1] > limit):
                break
            wanted = min(2 * wanted, finite)
        value, shapes = value[elastic], shapes[:, elastic]
        shapes = shapes / np.sqrt(np.einsum("in,in->n", shapes, M @ shapes))
        return cls(K, M, value, shapes, wanted - len(value), wanted == finite)

    @property
    def frequency(self) -> _Real:
        """Natural frequencies in Hz, shape (n,)."""
        return np.asarray(np.sqrt(self.value) / (2.0 * np.pi))

    @property
    def gap(self) -> _Real:
        """Distance to the next eigenvalue on either side, as a share of the own; shape (n,)."""
        away = np.diff(self.value, prepend=-np.inf, append=np.inf)
        return np.asarray(np.minimum(away[:-1], away[1:]) / self.value)


def slopes(
    modes: RealModes,
    which: int,
    system: AffineSystem,
    unknowns: Unknowns,
    values: _Real,
    rows: NDArray[np.intp] | None = None,
) -> tuple[_Real, _Real]:
    """Return the derivatives of one mode by the unknowns.

    Parameters
    ----------
    modes : RealModes
        Modes at `values`.
    which : int
        Of which one.
    system : AffineSystem
        The compiled model.
    unknowns : Unknowns
        Where the unknowns act; those on damping have no effect here.
    values : ndarray of float, shape (n,)
        The unknowns.
    rows : ndarray of int, shape (k,), optional
        DOFs at which the derivative of the shape is wanted. None: nowhere.

    Returns
    -------
    value : ndarray of float, shape (n,)
        Of the eigenvalue, in 1/s2.
    shape : ndarray of float, shape (n, k)
        Of the shape of unit modal mass.

    Raises
    ------
    SolverError
        If the shape's equations are singular: another mode has the same eigenvalue.
    """
    state = unknowns.state(system, values)
    phi, value = modes.shapes[:, which], float(modes.value[which])
    wanted = np.zeros(0, dtype=np.intp) if rows is None else rows
    mass_phi = modes.M @ phi
    # Columns: unit loads at the wanted DOFs, and M phi, whose solution gives the share of phi in the derivative.
    Z = np.zeros((len(phi), len(wanted) + 1))
    pivot = _pivot(modes, phi)
    if len(wanted):
        loads = np.zeros_like(Z)
        loads[wanted, np.arange(len(wanted))] = 1.0
        loads[:, -1] = mass_phi
        loads[pivot] = 0.0
        Z = _solved(modes, value, pivot, loads)
    d_value, d_mass = np.zeros(unknowns.n), np.zeros(unknowns.n)
    loaded = np.zeros((unknowns.n, Z.shape[1]))
    for owner, at, power in zip(unknowns.owner, unknowns.at, unknowns.power, strict=True):
        term = system.terms[at]
        if term.quantity not in ("stiffness", "mass"):
            continue
        share = power * state.factor[at] / values[owner]
        force = share * (term.local @ phi[term.own])
        if term.quantity == "mass":
            d_mass[owner] += force @ phi[term.own]
            force = -value * force
        d_value[owner] += force @ phi[term.own]
        loaded[owner] += force @ Z[term.own]
    # (K - lambda M) v = -(K' - lambda M') phi + lambda' M phi, with v zero at the pivot.
    v = -loaded + d_value[:, None] * (mass_phi @ Z)
    share_of_phi = -v[:, -1] - 0.5 * d_mass
    return d_value, v[:, :-1] + share_of_phi[:, None] * phi[wanted]


def _matrix(system: AffineSystem, state: State, quantity: str) -> Any:
    weights = np.where([t.quantity == quantity for t in system.terms], state.factor, 0.0)
    entries = system.real_values(weights), system.indices.copy(), system.indptr.copy()
    matrix = sp.csr_array(entries, shape=(system.n, system.n))
    matrix.eliminate_zeros()  # in place
    return matrix


def _pivot(modes: RealModes, phi: _Real) -> int:
    """Return the DOF that moves most, rotations and translations by their share of the strain energy."""
    return int(np.argmax(np.abs(phi) * np.sqrt(np.maximum(modes.K.diagonal(), 0.0))))


def _solved(modes: RealModes, value: float, pivot: int, loads: _Real) -> _Real:
    """Solve with K - lambda M, its row and column `pivot` taken out; the solution is zero there."""
    size = np.abs(modes.K.diagonal()) + value * np.abs(modes.M.diagonal())
    scale = 1.0 / np.sqrt(np.where(size > 0, size, 1.0))  # translations and rotations weigh alike
    scale[pivot] = 0.0
    one = sp.csc_array((np.ones(1), ([pivot], [pivot])), shape=modes.K.shape)
    A = sp.csc_array(sp.diags_array(scale) @ (modes.K - value * modes.M) @ sp.diags_array(scale) + one)
    B = scale[:, None] * loads
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", scipy.linalg.LinAlgWarning)
            if len(loads) <= eigen.DENSE_LIMIT:
                X = scipy.linalg.solve(A.toarray(), B, assume_a="sym")
            else:
                X = splu(A, permc_spec="MMD_AT_PLUS_A").solve(B)
    except (RuntimeError, np.linalg.LinAlgError, scipy.linalg.LinAlgWarning) as error:
        raise SolverError(_SINGULAR) from error
    if not np.linalg.norm(A @ X - B) <= _ACCURATE * np.linalg.norm(B):
        raise SolverError(_SINGULAR)
    return np.asarray(scale[:, None] * X)
