"""Measured mode shapes expanded to any DOF by the modes of the updated model."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from updyn.arrays import IndexArray, RealArray
from updyn.correlation.clusters import PairingRule, pair_clusters
from updyn.correlation.shapes import find_moving
from updyn.dofs import Dof, DofSet
from updyn.errors import DataError, OptionError, SolverError, suggest
from updyn.modal import ModeSet
from updyn.text_table import text_table
from updyn.uncertainty.combination import (
    Combination,
    choose_columns,
    combine,
    order_by_distance,
)
from updyn.uncertainty.draws import Draws
from updyn.uncertainty.mode_prediction import exclude_span
from updyn.uncertainty.posterior import Posterior, find_update
from updyn.uncertainty.updated_modes import UpdatedModes
from updyn.updating.modes import find_measured_modes
from updyn.updating.problem.modal import ModalTarget
from updyn.updating.problem.settings import MODE_PAIRS
from updyn.updating.result import JointResult, UpdateResult, find_result

__all__ = ["Expansion", "expand_modes"]

METHODS = ("local", "serep")


def expand_modes(
    source: UpdateResult | JointResult | Draws,
    modes: ModeSet | None = None,
    *,
    method: str = "local",
    dofs: Iterable[str | Dof] | None = None,
    test: str | None = None,
    tier: str | None = None,
) -> Expansion:
    """Expand measured mode shapes to any DOF by the modes of the updated model.

    Parameters
    ----------
    source : UpdateResult, JointResult or Draws
        An update, or draws of a bootstrap or a sampling.
    modes : ModeSet, optional
        The measured modes. By default those that were given to the update, or those that are
        identified from its FRFs (`updyn.identify_modes`).
    method : {"local", "serep"}
        ``"local"``: each measured shape is a least-squares combination of the mode of the model
        that is paired with it and of its neighbours in frequency, as many as reduce the
        leave-one-out error of the sensors (local correspondence; R. Brincker, A. Skafte, M.
        Lopez-Aenlle, A. Sestieri, W. D'Ambrogio & A. Canteli, Mech. Syst. Signal Process. 45 (2014)
        91). Sensors are weighted by their inverse variance. ``"serep"``: all measured shapes are
        unweighted combinations of the same modes, the paired ones (J. C. O'Callahan, P. Avitabile &
        R. Riemer, Proc. IMAC VII (1989) 29).
    dofs : iterable of str or Dof, optional
        Signed DOFs of the expanded shapes. By default all DOFs of the model.
    test, tier
        As in `updyn.predict_modes`.

    Returns
    -------
    Expansion

    Raises
    ------
    DataError
        If no measured mode has a pair in the model, no mode can be identified, or the sensors are
        too few.
    OptionError
        If `source` is neither an update nor draws with their update (`Draws.of`), or an option is
        not understood.
    DofError
        If a DOF is not in the model.

    Notes
    -----
    The variance of an expanded shape is the sum of three terms: of the combination, from the
    variance at the sensors (the noise of `ModeSet.std_shapes` and the excess below); of the modes
    of the model, from the covariance of the unknowns by exact derivatives, with the derivatives of
    the combination; and the variance that the residual at the sensors has in excess of their noise,
    at every DOF. The last one is an error of the model that no combination of its modes corrects.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> expansion = updyn.expand_modes(result, updyn.identify_modes(frf).select([0, 1]))
    >>> len(frf.responses), expansion.modes.shapes.shape
    (5, (12, 2))
    """
    if method not in METHODS:
        raise OptionError(f"method {method!r}: {suggest(str(method), METHODS)}")
    result = find_result(find_update(source), test)
    measured = find_measured_modes(result) if modes is None else modes
    if not isinstance(measured, ModeSet) or not measured.has_shapes:
        raise DataError(f"expand_modes: expected measured modes with shapes, found {measured!r}")
    highest = MODE_PAIRS.frequency_reach * float(measured.frequency[-1])
    updated = UpdatedModes.of(result, None, highest, tier)
    target = ModalTarget.of(updated.system, measured)
    all_paired = _pair(updated, target)
    is_paired = all_paired >= 0
    if not is_paired.any():
        listed = ", ".join(f"{f:.6g}" for f in measured.frequency)
        raise DataError(
            f"expand_modes: the updated model has no mode like the measured ones at {listed} Hz"
        )
    paired, unpaired = all_paired[is_paired], measured.frequency[~is_paired]
    measured, target = measured.select(is_paired), target.select(np.flatnonzero(is_paired).tolist())
    labels = updated.model.dofs if dofs is None else DofSet(dofs)
    match = updated.model.dofs.match(labels)
    expander = _Expander(updated, target, Posterior.of(source), match.index)
    A, n_elastic = target.at_sensors(expander.basis), updated.number
    frequency = np.zeros(A.shape[1])
    frequency[:n_elastic] = updated.modes.frequency[:n_elastic]
    found = []
    for r, p in enumerate(paired.tolist()):
        shape, noise = target.shapes[:, r], target.std_shapes[:, r] ** 2 / len(A)
        if method == "serep":
            found.append(combine(A, shape, np.zeros(len(A)), np.unique(paired)))
        else:
            near = order_by_distance(frequency, p)
            found.append(combine(A, shape, noise, choose_columns(A, shape, near)))
    length = np.linalg.norm(measured.real_shapes * np.abs(target.weight)[:, None], axis=0)
    shapes = np.column_stack([expander.expand(one) for one in found]) * length
    std = np.column_stack([expander.std(one) for one in found]) * length
    expanded = ModeSet(
        measured.frequency,
        shapes * match.sign[:, None],
        labels,
        measured.loss_factor,
        measured.scaled,
        measured.quality,
        source=f"expanded by the updated model ({method}): {measured.source}".rstrip(": "),
        std_frequency=measured.std_frequency,
        std_loss_factor=measured.std_loss_factor,
        std_shapes=std,
    )
    return Expansion(
        expanded,
        method,
        tuple(_number_modes(one.columns, n_elastic) for one in found),
        np.array([one.error for one in found]),
        np.sqrt([len(A) * one.excess for one in found]),
        tuple(unpaired.tolist()),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Expansion:
    """Measured mode shapes at further DOFs.

    Attributes
    ----------
    modes : ModeSet
        The expanded modes: measured frequencies and damping, real shapes in the scale of the
        measured ones, and their standard deviations.
    method : {"local", "serep"}
        Method of the expansion.
    combined : tuple of tuple of int
        For each mode, the combined modes of the updated model, from 0, without rigid-body modes;
        -1 for each rigid-body mode.
    error : ndarray of float, shape (n,)
        Error of the prediction of each sensor from all others, as rms over the sensors relative to
        the rms of the shape.
    model_error : ndarray of float, shape (n,)
        Standard deviation of the residual at the sensors in excess of their noise, relative to the
        rms of the shape.
    unpaired : tuple of float
        Frequencies in Hz of the measured modes that are not expanded, because no mode of the
        updated model is paired with them.
    """

    modes: ModeSet
    method: str
    combined: tuple[tuple[int, ...], ...]
    error: RealArray
    model_error: RealArray
    unpaired: tuple[float, ...] = ()

    def __repr__(self) -> str:
        return f"Expansion({len(self.modes)} modes at {len(self.modes.dofs)} DOFs, {self.method})"

    def summary(self) -> str:
        """Return a table of the modes, with their leave-one-out errors."""
        rows = [
            [
                str(k + 1),
                f"{frequency:.6g}",
                ", ".join("rigid" if c < 0 else str(c + 1) for c in self.combined[k]),
                f"{100.0 * self.error[k]:.3g} %",
                f"{100.0 * self.model_error[k]:.3g} %",
            ]
            for k, frequency in enumerate(self.modes.frequency)
        ]
        header = ["mode", "frequency (Hz)", "combined modes of the model", "error", "model error"]
        texts = [
            f"Measured shapes expanded to {len(self.modes.dofs)} DOFs ({self.method}). Error: of"
            " each sensor, predicted from all others.",
            text_table(header, rows),
        ]
        if self.unpaired:
            listed = ", ".join(f"{f:.6g}" for f in self.unpaired)
            texts.append(f"Not expanded, without a pair in the updated model: {listed} Hz.")
        return "\n".join(texts)


def _number_modes(columns: IndexArray, n_elastic: int) -> tuple[int, ...]:
    """Return the numbers of modes; -1 for rigid-body modes, which follow `n_elastic` others."""
    return tuple(np.where(columns < n_elastic, columns, -1).tolist())


def _pair(updated: UpdatedModes, target: ModalTarget) -> IndexArray:
    """Return the mode of the model that is paired with each measured one, (m,); -1: none."""
    shapes = updated.modes.shapes[:, : updated.number]
    A, moving = target.at_sensors(shapes), np.flatnonzero(find_moving(shapes[target.rows], shapes))
    frequencies = updated.modes.frequency[moving], target.frequency
    paired = np.full(len(target.value), -1)
    if len(moving):
        pairs = pair_clusters(A[:, moving], target.shapes, frequencies, PairingRule()).pairs
        paired[pairs.second] = moving[pairs.first]
    return paired


@dataclass(slots=True, eq=False)
class _Expander:
    """Expanded shapes of unit length and their standard deviations at the DOFs `rows`."""

    updated: UpdatedModes
    target: ModalTarget
    posterior: Posterior
    rows: IndexArray
    #: The modes of the model, and the rigid-body modes after them, shape (N, n).
    basis: RealArray = field(init=False)
    _slopes: dict[int, RealArray] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        modes = self.updated.modes
        self.basis = np.hstack([modes.shapes[:, : self.updated.number], modes.rigid])

    def expand(self, found: Combination) -> RealArray:
        """Return the expanded shape, shape (k,)."""
        return np.asarray(self._modes(found) @ found.amplitudes)

    def std(self, found: Combination) -> RealArray:
        """Return standard deviations at fixed length, shape (k,); nan if they are not known."""
        shape = self.expand(found)
        by_noise = exclude_span(self._modes(found) @ found.root, shape[:, None])
        level = self._level(shape)
        variance = np.sum(by_noise**2, axis=1) + found.excess * level**2
        try:
            by_value = exclude_span(self._derivatives(found), shape[:, None])
        except SolverError:
            return np.full(len(shape), np.nan)
        return np.hypot(np.sqrt(variance), self.posterior.propagate(by_value, np.abs(shape).max()))

    def _modes(self, found: Combination) -> RealArray:
        return self.basis[np.ix_(self.rows, found.columns)]

    def _derivatives(self, found: Combination) -> RealArray:
        """Return the derivatives of the expanded shape by the unknowns, shape (k, n)."""
        slopes = [self._slope(int(column)) for column in found.columns]
        along = sum(a * slope for a, slope in zip(found.amplitudes, slopes, strict=True))
        at_sensors = self.target.at_sensors(along)
        across = np.stack([found.residual_share @ self.target.at_sensors(one) for one in slopes])
        by_amplitude = found.root @ (found.root.T @ across) - found.gain @ at_sensors
        return np.asarray(along[self.rows] + self._modes(found) @ by_amplitude)

    def _slope(self, column: int) -> RealArray:
        """Return the derivatives of a mode by the unknowns, shape (N, n)."""
        if column >= self.updated.number:  # the span of rigid-body modes is constant
            return np.zeros((self.updated.system.n, self.updated.unknowns.n))
        if column not in self._slopes:
            self._slopes[column] = self.updated.differentiate(column).shape
        return self._slopes[column]

    def _level(self, shape: RealArray) -> RealArray:
        """Return the scale of motions, by which `ModalTarget` divides, at each DOF, shape (k,)."""
        dofs = self.updated.model.dofs
        rotates, of_sensors = dofs.axes[self.rows] >= 3, dofs.axes[self.target.rows] >= 3
        level = np.zeros(len(shape))
        for kind in (False, True):
            at, sensors = rotates == kind, of_sensors == kind
            if sensors.any():
                level[at] = 1.0 / abs(self.target.weight[sensors][0])
            elif at.any():
                # No such sensor: the rms of the expanded shape.
                level[at] = np.sqrt(np.mean(shape[at] ** 2) * len(self.target.rows))
        return level
