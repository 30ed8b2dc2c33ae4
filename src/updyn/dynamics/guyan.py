"""Static condensation of a model's mass to its measured DOFs."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from updyn.arrays import RealArray
from updyn.dofs import Dof, DofSet
from updyn.dynamics.settings import STATIC_CONDENSATION
from updyn.errors import SolverError
from updyn.model import Model

__all__ = ["reduced_mass"]

_LOOSE = (
    "with the measured DOFs fixed, the structure can still move without stiffness; its mass cannot"
    " be reduced to them"
)


def reduced_mass(model: Model, dofs: Iterable[str | Dof]) -> RealArray:
    """Return T^T M T, T = [I; -K_ss^-1 K_sn], in kg (kg m2) (Guyan, AIAA J. 3 (1965) 380)."""
    # A sign reverses a DOF. The mass is accurate for modes that resemble the deformation under
    # static loads at these DOFs.
    kept = DofSet(dofs)
    match = model.dofs.match(kept, "DOF to keep")
    rest = model.dofs.complement(kept)
    T = np.zeros((model.n_dofs, len(kept)))
    T[match.index, np.arange(len(kept))] = match.sign
    model.refuse_nonlinear("static condensation")
    K = sp.csr_array(model.stiffness)
    loads = -(K @ T)[rest]
    K_rest = sp.csc_array(K[rest][:, rest])
    if len(rest):
        T[rest] = _solve_static(K_rest, loads)
    return np.asarray(T.T @ (model.mass @ T))


def _solve_static(K: sp.csc_array, loads: RealArray) -> RealArray:
    diagonal = K.diagonal()
    if not (diagonal > 0).all():
        raise SolverError(_LOOSE)
    unit = 1.0 / np.sqrt(diagonal)  # independent of units and of rotations or translations
    scaled = sp.csc_array(sp.diags_array(unit) @ K @ sp.diags_array(unit))
    right = unit[:, None] * loads
    try:
        found = splu(scaled, permc_spec="MMD_AT_PLUS_A").solve(right)
    except RuntimeError as error:
        raise SolverError(_LOOSE) from error
    level = np.abs(found).max(initial=0.0) + np.abs(right).max(initial=0.0)
    residual = np.abs(scaled @ found - right).max(initial=0.0)
    if not residual <= STATIC_CONDENSATION.backward_error * level:
        raise SolverError(_LOOSE)
    return np.asarray(unit[:, None] * found)
