"""Undamped modes of a compiled model and their exact derivatives by the unknowns.

Eigenvalues: R. L. Fox & M. P. Kapoor, "Rates of change of eigenvalues and eigenvectors", AIAA J. 6
(1968) 2426-2429, eq. 6. Eigenvectors: R. B. Nelson, "Simplified calculation of eigenvector
derivatives", AIAA J. 14 (1976) 1201-1205, with one factorisation for each mode; for a small model
the sum over all modes (Fox & Kapoor). Modes of one eigenvalue have derivatives in a basis in which
no unknown couples them, if it exists (R. L. Dailey, "Eigenvector derivatives with repeated
eigenvalues", AIAA J. 27 (1989) 486-491), see `separate_repeated_modes`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from updyn.arrays import IndexArray, IntegerArray, RealArray
from updyn.dynamics import eigen
from updyn.dynamics.affine import AffineSystem, State
from updyn.dynamics.settings import EIGEN
from updyn.errors import SolverError
from updyn.group import Matrix
from updyn.modal.settings import MODE_DERIVATIVE
from updyn.sensitivity import Unknowns

__all__ = [
    "CompleteBasis",
    "RealModes",
    "assemble",
    "derivative_forces",
    "differentiate_mode",
    "differentiate_modes",
    "separate_repeated_modes",
]


_SINGULAR = "the equations of the derivative of a mode shape are singular"


@dataclass(frozen=True, slots=True, eq=False)
class CompleteBasis:
    """All modes of a model, or of a reduced one, as V C; K and M are diagonal in it.

    `blocks` are the columns of V, shape (N, r) together, and `rotation` is C, shape (r, r), or None
    for the identity. `stiffness` and `mass`, shape (r,), are the diagonals; the mass is 0 for
    motions without mass.
    """

    blocks: tuple[RealArray, ...]
    rotation: RealArray | None
    stiffness: RealArray
    mass: RealArray

    def expand(self, rows: IntegerArray | slice | None, amplitudes: RealArray) -> RealArray:
        """Return the motion at some DOFs, shape (k, ...), of modal amplitudes, shape (r, ...)."""
        turned = amplitudes if self.rotation is None else self.rotation @ amplitudes
        V = self.blocks[0][rows]
        if len(self.blocks) > 1:
            V = np.hstack([block[rows] for block in self.blocks])
        return np.asarray(V @ turned)

    def project(self, rows: IndexArray | slice, forces: RealArray) -> RealArray:
        """Return the modal forces, shape (r, ...), of forces at some DOFs, shape (k, ...)."""
        projected = np.concatenate([block[rows].T @ forces for block in self.blocks])
        return projected if self.rotation is None else np.asarray(self.rotation.T @ projected)


@dataclass(frozen=True, slots=True, eq=False)
class RealModes:
    """The lowest undamped modes, without rigid-body modes.

    K (N/m) and M (kg), shape (N, N), are sparse, real and symmetric. `value`, shape (n,), are
    omega^2 in 1/s2, ascending; `shapes`, shape (N, n), and `rigid`, the rigid-body modes, have unit
    modal mass. `complete`: these are all modes of the model. `whole`, for a small or a reduced
    model, are all its modes.
    """

    K: Matrix
    M: Matrix
    value: RealArray
    shapes: RealArray
    rigid: RealArray
    complete: bool
    whole: CompleteBasis | None = None

    @classmethod
    def lowest(cls, system: AffineSystem, state: State, n: int, highest: float) -> RealModes:
        """Compute the lowest `n` modes, without rigid-body modes, and more up to `highest` in Hz.

        The highest mode exceeds this frequency; there are fewer if the model has no more.
        """
        K, M = assemble(system, state, "stiffness"), assemble(system, state, "mass")
        finite, limit = eigen.mass_rank(M), (2.0 * np.pi * highest) ** 2
        wanted = min(n + 6, finite)
        whole = None
        while True:
            if K.shape[0] <= MODE_DERIVATIVE.most_decomposed_dofs:
                value, shapes, (V, *diagonals) = eigen.all_pairs(K, M, wanted)
                whole = CompleteBasis((V,), None, *diagonals)
            else:
                value, shapes = eigen.real_pairs(K, M, wanted)
            elastic = np.einsum("in,in->n", shapes, K @ shapes) > _energy_rounding(K, shapes)
            if wanted == finite or (elastic.sum() >= n and value[-1] > limit):
                break
            wanted = min(2 * wanted, finite)
        shapes = shapes / np.sqrt(np.einsum("in,in->n", shapes, M @ shapes))
        found = value[elastic], shapes[:, elastic], shapes[:, ~elastic]
        return cls(K, M, *found, wanted == finite, whole)

    @property
    def frequency(self) -> RealArray:
        """Natural frequencies in Hz, shape (n,)."""
        return np.asarray(np.sqrt(self.value) / (2.0 * np.pi))

    @property
    def rounding(self) -> RealArray:
        """Bound of the relative rounding errors of the eigenvalues, shape (n,)."""
        return _energy_rounding(self.K, self.shapes) / self.value

    def find_repeated(self, which: int) -> IndexArray:
        """Return all modes with the eigenvalue of mode `which`, including itself."""
        reach = MODE_DERIVATIVE.equal_eigenvalues * self.value[which]
        return np.flatnonzero(np.abs(self.value - self.value[which]) <= reach)


def _energy_rounding(K: Matrix, shapes: RealArray) -> RealArray:
    """Return a bound of the rounding errors of phi^T K phi."""
    roundings = MODE_DERIVATIVE.zero_energy_roundings * np.finfo(np.float64).eps
    sizes = np.abs(shapes)
    return np.asarray(roundings * np.einsum("in,in->n", sizes, abs(K) @ sizes))


def differentiate_mode(
    modes: RealModes,
    which: int,
    system: AffineSystem,
    unknowns: Unknowns,
    values: RealArray,
    rows: IndexArray | None = None,
    along: RealArray | None = None,
) -> tuple[RealArray, RealArray]:
    """Return the derivatives of one mode by the unknowns.

    Those of the eigenvalue, shape (n,), are in 1/s2. Those of the shape of unit modal mass, shape
    (n, k + p), are at the k DOFs `rows` and along the constant vectors `along`, shape (N, p).
    Unknowns on damping have no effect.
    """
    phi, value, group = (
        modes.shapes[:, which],
        float(modes.value[which]),
        modes.find_repeated(which),
    )
    basis = modes.shapes[:, group]
    by_value, by_mass = np.zeros((2, unknowns.n, len(group)))
    forces = np.zeros((len(phi), unknowns.n))
    for owner, rows_of_term, force, is_mass in derivative_forces(system, unknowns, values, phi):
        if is_mass:
            by_mass[owner] += force @ basis[rows_of_term]
            force = -value * force
        by_value[owner] += force @ basis[rows_of_term]
        forces[rows_of_term, owner] += force
    own_index = int(np.flatnonzero(group == which)[0])
    _check_uncoupled(by_value, own_index, values, value)
    d_value = by_value[:, own_index].copy()
    rows = np.zeros(0, dtype=np.intp) if rows is None else rows
    if not len(rows) and along is None:
        return d_value, np.zeros((unknowns.n, 0))
    # (K - lambda M) v = -(K' - lambda M') phi + lambda' M phi, with v zero at the pivots.
    pivots, mass_basis = _choose_pivots(modes, basis), modes.M @ basis
    loads = mass_basis[:, own_index, None] * d_value - forces
    loads[pivots] = 0.0
    v = _solve_with_pivots(modes, value, pivots, loads)
    shape = v - basis @ (mass_basis.T @ v + 0.5 * by_mass.T)
    projected = np.zeros((0, unknowns.n)) if along is None else along.T @ shape
    return d_value, np.concatenate([shape[rows], projected]).T


def _check_uncoupled(by_value: RealArray, own_index: int, values: RealArray, value: float) -> None:
    """Raise SolverError if an unknown couples a mode with another of its eigenvalue.

    `by_value`, shape (n, m), is phi_j^T (K' - lambda M') phi of all modes j of the eigenvalue.
    """
    others = np.delete(by_value, own_index, axis=1)
    if (np.abs(others * values[:, None]) > MODE_DERIVATIVE.uncoupled_change * value).any():
        raise SolverError(
            f"{by_value.shape[1]} modes of the model coincide at"
            f" {np.sqrt(value) / (2.0 * np.pi):.6g} Hz, and the unknowns couple them: they have no"
            " derivatives one by one. Break the symmetry in the start of the unknowns, or use a"
            " method that fits the FRFs"
        )


def differentiate_modes(
    modes: RealModes,
    which: IndexArray,
    system: AffineSystem,
    unknowns: Unknowns,
    values: RealArray,
    rows: IndexArray | None = None,
    along: RealArray | None = None,
) -> tuple[RealArray, RealArray]:
    """Return the derivatives of several modes by the unknowns, as `differentiate_mode`.

    `along`, shape (N, m), has a vector for each mode. Shapes: (m, n) and (m, n, k + 1).
    """
    if modes.whole is None:
        derivatives = [
            differentiate_mode(
                modes,
                int(mode),
                system,
                unknowns,
                values,
                rows,
                None if along is None else along[:, i : i + 1],
            )
            for i, mode in enumerate(which)
        ]
        return np.array([value for value, _ in derivatives]), np.array(
            [shape for _, shape in derivatives]
        )
    return _differentiate_by_expansion(
        modes, modes.whole, which, system, unknowns, values, rows, along
    )


def _differentiate_by_expansion(
    modes: RealModes,
    whole: CompleteBasis,
    which: IndexArray,
    system: AffineSystem,
    unknowns: Unknowns,
    values: RealArray,
    rows: IndexArray | None,
    along: RealArray | None,
) -> tuple[RealArray, RealArray]:
    """Return `differentiate_modes` by the sum over all modes of the model."""
    stiffness, mass = whole.stiffness, whole.mass
    phi, value = modes.shapes[:, which], modes.value[which]
    projected, by_mass = np.zeros((2, unknowns.n, len(mass), len(which)))
    for owner, own_rows, force, is_mass in derivative_forces(system, unknowns, values, phi):
        pushed = whole.project(own_rows, force)
        if is_mass:
            by_mass[owner] += pushed
            pushed = pushed * -value
        projected[owner] += pushed
    # K - lambda M is diagonal in this basis, and zero for the modes of the eigenvalue itself.
    own_value = np.full(len(mass), np.inf)
    np.divide(stiffness, mass, out=own_value, where=mass > 0.0)
    same = np.abs(own_value[:, None] - value) <= MODE_DERIVATIVE.equal_eigenvalues * value
    gap = np.where(same, 1.0, stiffness[:, None] - mass[:, None] * value)
    shares = np.where(same, 0.0, -projected / gap)
    number = 0 if rows is None else len(rows)
    d_value = np.zeros((len(which), unknowns.n))
    shape = np.zeros((len(which), unknowns.n, number + (along is not None)))
    groups = [modes.find_repeated(int(mode)) for mode in which]
    needed = np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *groups]))
    mass_forces = whole.project(slice(None), modes.M @ modes.shapes[:, needed])
    for i, (mode, group) in enumerate(zip(which, groups, strict=True)):
        # phi_j is a sum of them, because modes of one eigenvalue may have been rotated.
        at = mass_forces[np.ix_(same[:, i], np.searchsorted(needed, group))]
        at /= mass[same[:, i], None]
        by_value = projected[:, same[:, i], i] @ at
        own_index = int(np.flatnonzero(group == mode)[0])
        _check_uncoupled(by_value, own_index, values, float(value[i]))
        d_value[i] = by_value[:, own_index]
        fully = shares[:, :, i].copy()
        fully[:, same[:, i]] = -0.5 * (by_mass[:, same[:, i], i] @ at) @ at.T
        if number:
            shape[i, :, :number] = whole.expand(rows, fully.T).T
        if along is not None:
            shape[i, :, -1] = fully @ whole.project(slice(None), along[:, i])
    return d_value, shape


def separate_repeated_modes(
    modes: RealModes,
    system: AffineSystem,
    unknowns: Unknowns,
    values: RealArray,
    shapes_at_sensors: Callable[[RealArray], RealArray],
    measured: RealArray,
) -> RealModes:
    """Return the modes in a basis in which no unknown couples modes of one eigenvalue.

    If the unknowns do not determine the basis, it follows the measured shapes of unit length, (k,
    n_m). `shapes_at_sensors` maps shapes, (N, m), to the sensors, (k, m).
    """
    first, shapes = 0, modes.shapes
    while first < len(modes.value):
        group = modes.find_repeated(first)
        if len(group) > 1:
            if shapes is modes.shapes:
                shapes = shapes.copy()
            turned = shapes[:, group] @ _decoupling_rotation(
                system, unknowns, values, shapes[:, group], float(modes.value[first])
            )
            mixed = _compute_couplings(system, unknowns, values, turned, float(modes.value[first]))
            level = np.sum(mixed, axis=0).diagonal()
            reach = MODE_DERIVATIVE.uncoupled_change * modes.value[first]
            start = 0
            for stop in range(1, len(group) + 1):
                if stop == len(group) or abs(level[stop] - level[start]) > reach:
                    part = turned[:, start:stop]
                    turned[:, start:stop] = part @ _rotate_towards_measured(
                        shapes_at_sensors(part), measured
                    )
                    start = stop
            shapes[:, group] = turned
        first = int(group[-1]) + 1
    if shapes is modes.shapes:
        return modes
    return replace(modes, shapes=shapes)


def derivative_forces(
    system: AffineSystem, unknowns: Unknowns, values: RealArray, shapes: RealArray
) -> Iterator[tuple[int, IndexArray | slice, RealArray, bool]]:
    """Yield unknown, DOFs, derivative times shapes, and whether it is of mass, by drive."""
    state = unknowns.state(system, values)
    drives = zip(unknowns.owner, unknowns.at, unknowns.power, unknowns.scales, strict=True)
    for owner, at, power, scales in drives:
        term = system.terms[at]
        if scales and term.quantity in ("stiffness", "mass"):
            share = power * state.factor[at] / values[owner]
            yield (
                int(owner),
                term.row_index,
                share * (term.local @ shapes[term.row_index]),
                term.quantity == "mass",
            )


def _compute_couplings(
    system: AffineSystem, unknowns: Unknowns, values: RealArray, basis: RealArray, value: float
) -> RealArray:
    """Return weighted Phi^T (K' - lambda M') Phi by the logarithm of each unknown, (n, m, m)."""
    out = np.zeros((unknowns.n, basis.shape[1], basis.shape[1]))
    for owner, rows_of_term, force, is_mass in derivative_forces(system, unknowns, values, basis):
        # Arbitrary weights that are not in a simple ratio.
        weight = values[owner] * (1.0 + 0.5 * np.sin(1.0 + owner))
        if is_mass:
            weight *= -value
        out[owner] += weight * (basis[rows_of_term].T @ force)
    return out


def _decoupling_rotation(
    system: AffineSystem, unknowns: Unknowns, values: RealArray, basis: RealArray, value: float
) -> RealArray:
    """Return the rotation, shape (m, m), after which the sum of all couplings is diagonal."""
    whole = _compute_couplings(system, unknowns, values, basis, value).sum(axis=0)
    return np.asarray(np.linalg.eigh((whole + whole.T) / 2)[1])


def _rotate_towards_measured(shapes_at_sensors: RealArray, measured: RealArray) -> RealArray:
    """Return the rotation, (m, m), that orders shapes by their agreement with measured ones."""
    if not len(shapes_at_sensors):
        return np.eye(shapes_at_sensors.shape[1])
    share = np.linalg.lstsq(shapes_at_sensors, measured, rcond=None)[0]
    near = np.linalg.norm(shapes_at_sensors @ share, axis=0)
    order = np.argsort(-near, kind="stable")[: len(share)]
    order = order[near[order] ** 2 > MODE_DERIVATIVE.least_share_within]
    return np.asarray(np.linalg.qr(np.hstack([share[:, order], np.eye(len(share))]))[0])


def assemble(system: AffineSystem, state: State, quantity: str) -> Matrix:
    """Return the sparse stiffness or mass of a compiled model at a state."""
    weights = np.where([t.quantity == quantity for t in system.terms], state.factor, 0.0)
    entries = system.real_values(weights), system.indices.copy(), system.indptr.copy()
    matrix = sp.csr_array(entries, shape=(system.n, system.n))
    matrix.eliminate_zeros()  # in place
    return matrix


def _choose_pivots(modes: RealModes, basis: RealArray) -> IndexArray:
    """Return the DOFs of largest motion, one for each mode, weighted by strain energy."""
    weighted = basis.T * np.sqrt(np.maximum(modes.K.diagonal(), 0.0))
    return np.asarray(
        scipy.linalg.qr(weighted, mode="r", pivoting=True)[1][: basis.shape[1]], dtype=np.intp
    )


def _solve_with_pivots(
    modes: RealModes, value: float, pivots: IndexArray, loads: RealArray
) -> RealArray:
    """Solve (K - lambda M) X = loads without rows and columns `pivots`, where X is zero."""
    size = np.abs(modes.K.diagonal()) + value * np.abs(modes.M.diagonal())
    scale = 1.0 / np.sqrt(np.where(size > 0, size, 1.0))  # equal translations and rotations
    scale[pivots] = 0.0
    dense = len(loads) <= EIGEN.dense_dofs
    A = (_scaled_full if dense else _scaled_sparse)(modes, value, scale, pivots)
    B = scale[:, None] * loads
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", scipy.linalg.LinAlgWarning)
            if dense:
                X = scipy.linalg.solve(A, B, assume_a="sym")
            else:
                X = splu(A, permc_spec="MMD_AT_PLUS_A").solve(B)
    except (RuntimeError, np.linalg.LinAlgError, scipy.linalg.LinAlgWarning) as error:
        raise SolverError(_SINGULAR) from error
    if not np.linalg.norm(A @ X - B) <= MODE_DERIVATIVE.largest_residual * np.linalg.norm(B):
        raise SolverError(_SINGULAR)
    return np.asarray(scale[:, None] * X)


def _scaled_full(modes: RealModes, value: float, scale: RealArray, pivots: IndexArray) -> RealArray:
    """Return the scaled dense matrix with 1 on the diagonal at the pivots."""
    A: RealArray = modes.K.toarray()
    A -= value * modes.M.toarray()
    A *= scale
    A *= scale[:, None]
    A[pivots, pivots] = 1.0
    return A


def _scaled_sparse(
    modes: RealModes, value: float, scale: RealArray, pivots: IndexArray
) -> sp.csc_array:
    """Return the scaled sparse matrix with 1 on the diagonal at the pivots."""
    one = sp.csc_array((np.ones(len(pivots)), (pivots, pivots)), shape=modes.K.shape)
    by = sp.diags_array(scale)
    return sp.csc_array(by @ (modes.K - value * modes.M) @ by + one)
