"""`modify`: changes of modes and FRFs by a modification, with intervals."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment

from updyn.arrays import RealArray
from updyn.dofs import Dof
from updyn.errors import SolverError, UpdynWarning
from updyn.frf import FRF
from updyn.model import Model
from updyn.modification.changed import ChangedUpdate, change_update
from updyn.modification.settings import MODIFICATION
from updyn.notebook import card, table
from updyn.text_table import format_count, percent, text_table
from updyn.uncertainty.counts import check_level
from updyn.uncertainty.mode_prediction import select_count
from updyn.uncertainty.posterior import Posterior
from updyn.uncertainty.prediction import differentiate_frf
from updyn.uncertainty.restored import at_alternative
from updyn.uncertainty.updated_modes import UpdatedModes
from updyn.updating.result import JointResult, UpdateResult, find_result, interval_quantile

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["FRFChange", "ModeChange", "Modification", "modify"]


def modify(
    result: UpdateResult | JointResult,
    change: Callable[[Model], Model],
    n: int | None = None,
    *,
    test: str | None = None,
    tier: str | None = None,
) -> Modification:
    """Predict the effect of a change of the structure, before it is made.

    Parameters
    ----------
    result : UpdateResult or JointResult
        An update of the structure.
    change : callable
        Function from a model to the changed model, with the same degrees of freedom: `Model.scaled`
        for groups, `Model.with_element` for a mass, a spring or a dashpot, `Model.with_damping`. It
        is applied to the model before and after the update, so that the unknowns keep their effect;
        a damping value that it states replaces an unknown.
    n : int, optional
        Number of modes, as for `updyn.predict_modes`.
    test : str, optional
        Test whose model is used; required if the update has several.
    tier : {"dense", "sparse", "reduced"}, optional
        As for `updyn.predict_modes`.

    Returns
    -------
    Modification

    Raises
    ------
    OptionError
        If the change returns no model of the same degrees of freedom, it depends on the values of
        the unknowns, or an option is not understood.
    SolverError
        If the modes cannot be computed.

    Warns
    -----
    UpdynWarning
        If other answers fit the data equally well; `Modification.others` has the effect by each.

    Notes
    -----
    The unknowns have one covariance before and after the change. The standard deviation of a
    difference follows from the difference of the derivatives (delta method), and is therefore often
    far below that of the values. Intervals are Gaussian, or Student's if the noise is estimated
    from few numbers, as `UpdateResult.intervals`. Errors of the model are not covered.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> found = updyn.modify(result, lambda m: m.with_element("ballast", ["12:X"], mass=0.5))
    >>> bool(found.modes[0].change < 0.0)
    True
    """
    one = find_result(result, test)
    options = n, test, tier
    found = _predict_change(result, change, Posterior.of(result), options)
    if not one.alternatives:
        return found
    others = []
    for alternative in one.alternatives:
        posterior = Posterior.of_alternative(result, alternative)
        if posterior is not None:
            other = at_alternative(result, alternative, posterior.of_values)
            others.append(_predict_change(other, change, posterior, options))
    count = format_count(len(one.alternatives), "other answer")
    advice = "Modification.others has the effect by each" if others else "only this is given"
    warnings.warn(
        f"the update has {count} that may fit as well; the change is predicted by the first, and"
        f" {advice}",
        UpdynWarning,
        stacklevel=2,
    )
    return replace(found, others=tuple(others))


def _predict_change(
    result: UpdateResult | JointResult,
    change: Callable[[Model], Model],
    posterior: Posterior,
    options: tuple[int | None, str | None, str | None],
) -> Modification:
    """Return the effect of a change by one answer."""
    n, test, tier = options
    one = find_result(result, test)
    number, highest = select_count(one, n)
    changed = change_update(one, change)
    before = UpdatedModes.of(one, number, highest, tier)
    further = min(before.number + MODIFICATION.further_modes, one.start.n_dofs)
    after = UpdatedModes.of(changed.result, further, highest, tier)
    freedom = one.noise.get("degrees_of_freedom")
    modes = _compare_modes(before, after, changed, posterior, freedom)
    return Modification(one.model, changed.result.model, modes, one, changed, posterior)


@dataclass(frozen=True, slots=True)
class ModeChange:
    """Change of one mode.

    Attributes
    ----------
    before, after : float
        Natural frequency in Hz, and that of the most similar mode after the change.
    std_before, std_after, std_change : float
        Standard deviations in Hz, of the difference too; nan where they are undetermined.
    similarity : float
        Square of the cross-orthogonality of both shapes with the mass before the change, 0 to 1.
    degrees_of_freedom : int or None
        Those of Student's distribution of the interval; None for a Gaussian.

    Examples
    --------
    >>> mode = updyn.ModeChange(10.0, 9.5, 0.1, 0.1, 0.02, similarity=0.99)
    >>> mode.change, [round(end, 3) for end in mode.interval()]
    (-0.5, [-0.539, -0.461])
    """

    before: float
    after: float
    std_before: float
    std_after: float
    std_change: float
    similarity: float
    degrees_of_freedom: int | None = None

    @property
    def change(self) -> float:
        """Difference of the frequencies in Hz."""
        return self.after - self.before

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the confidence interval of the difference in Hz.

        Parameters
        ----------
        level : float
            Probability that the interval covers the true difference.

        Returns
        -------
        (float, float)
        """
        half = interval_quantile(check_level(level), self.degrees_of_freedom) * self.std_change
        return self.change - half, self.change + half


@dataclass(frozen=True, slots=True, eq=False)
class FRFChange:
    """Change of FRFs; all arrays of shape (n_f, n_responses, n_references).

    Attributes
    ----------
    before, after : FRF
        FRFs of the updated model.
    change_db : ndarray of float
        Change of the magnitude in dB; nan between motions that are not coupled.
    std_db : ndarray of float
        Its standard deviation; inf where an undetermined combination of unknowns changes it.
    degrees_of_freedom : int or None
        Those of Student's distribution of the interval; None for a Gaussian.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> found = updyn.modify(result, lambda m: m.with_element("ballast", ["12:X"], mass=0.5), 2)
    >>> change = found.frf([5.0], ["12:X"], ["1:X"])
    >>> change.change_db.shape, bool(change.std_db[0, 0, 0] < 1.0)
    ((1, 1, 1), True)
    """

    before: FRF
    after: FRF
    change_db: RealArray
    std_db: RealArray
    degrees_of_freedom: int | None = None

    def interval(self, level: float = 0.95) -> tuple[RealArray, RealArray]:
        """Return the ends of the confidence interval of the change in dB.

        Parameters
        ----------
        level : float
            Probability that the interval covers the true change, at every value by itself.

        Returns
        -------
        low, high : ndarray of float
        """
        half = interval_quantile(check_level(level), self.degrees_of_freedom) * self.std_db
        return self.change_db - half, self.change_db + half


@dataclass(frozen=True, slots=True, eq=False)
class Modification:
    """Effect of a change of the structure.

    Attributes
    ----------
    before, after : Model
        The updated model and the changed one.
    modes : tuple of ModeChange
        Changes of the modes, by ascending frequency before the change.
    others : tuple of Modification
        The effect by each other answer of the update that fits the data equally well
        (`UpdateResult.alternatives`); empty for updates to modes.

    Examples
    --------
    >>> from updyn.demos import chain
    >>> model, frf = chain.build(), chain.measure()
    >>> unknowns = updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")
    >>> result = updyn.update(model, frf, unknowns, starts=0)
    >>> found = updyn.modify(result, lambda m: m.with_element("ballast", ["12:X"], mass=0.5), 2)
    >>> found, float(found.after.group("ballast").mass.sum())
    (Modification(2 modes), 0.5)
    """

    before: Model
    after: Model
    modes: tuple[ModeChange, ...]
    _result: UpdateResult = field(repr=False)
    _changed: ChangedUpdate = field(repr=False)
    _posterior: Posterior = field(repr=False)
    others: tuple[Modification, ...] = ()

    @property
    def updates(self) -> tuple[UpdateResult, UpdateResult]:
        """The update, and the same with changed models, without unknowns that the change states."""
        return self._result, self._changed.result

    def frf(
        self,
        freq: ArrayLike,
        responses: Iterable[str | Dof],
        references: Iterable[str | Dof],
        *,
        quantity: str | None = None,
    ) -> FRFChange:
        """Return the change of FRFs at any lines and DOFs of the model.

        Parameters
        ----------
        freq : array_like of float, shape (n_f,)
            Lines in Hz.
        responses, references : iterable of str or Dof
            DOFs of the model, measured or not.
        quantity : str, optional
            Quantity of the FRFs; by default that of the measurement, for modes the receptance.

        Returns
        -------
        FRFChange

        Raises
        ------
        DofError
            If a response or a reference is no DOF of the model.
        SolverError
            If a model cannot be solved at a line.
        """
        asked = freq, list(responses), list(references), quantity
        before, d_before = differentiate_frf(self._result, *asked)
        after, d_after = differentiate_frf(self._changed.result, *asked)
        # The derivatives of ln|H| are the real part of dH / H.
        decibels = 20.0 / np.log(10.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = self._changed.expand((d_after / after.values[..., None]).real)
            slope = slope - (d_before / before.values[..., None]).real
            change = decibels * np.log(np.abs(after.values / before.values))
        known = np.isfinite(slope).all(axis=-1)
        std = decibels * self._posterior.propagate(np.where(known[..., None], slope, 0.0), 1.0)
        std = np.nan_to_num(std, nan=np.inf)
        change, std = (np.where(known, values, np.nan) for values in (change, std))
        freedom = self._result.noise.get("degrees_of_freedom")
        return FRFChange(before, after, change, std, freedom)

    def to_pandas(self, level: float = 0.95) -> pd.DataFrame:
        """Return a table with a row for each mode.

        Parameters
        ----------
        level : float
            Probability of the interval.

        Returns
        -------
        pandas.DataFrame
            Index: ``mode`` from 1. Columns: ``before``, ``after``, ``change``, ``low`` and ``high``
            (ends of the interval of the change), all in Hz, and ``similarity``.
        """
        import pandas as pd

        rows = []
        for mode in self.modes:
            low, high = mode.interval(level)
            rows.append(
                {
                    "before": mode.before,
                    "after": mode.after,
                    "change": mode.change,
                    "low": low,
                    "high": high,
                    "similarity": mode.similarity,
                }
            )
        return pd.DataFrame(rows, index=pd.RangeIndex(1, len(rows) + 1, name="mode"))

    def summary(self) -> str:
        """Return the changes of the modes as text, with 95 % intervals.

        Returns
        -------
        str
        """
        blocks = [text_table(_HEADINGS, self._rows())]
        for number, other in enumerate(self.others, 2):
            blocks += [f"By answer {number}, which fits as well:", other.summary()]
        return "\n\n".join(blocks)

    def _rows(self) -> list[list[str]]:
        rows = []
        for number, mode in enumerate(self.modes, 1):
            low, high = mode.interval()
            digits = 6 - math.floor(math.log10(mode.before))  # less is rounding
            low, change, high = (round(x, digits) + 0.0 for x in (low, mode.change, high))
            span = f"{low:+.4g} to {high:+.4g}" if np.isfinite(low) else "not determined"
            values = f"{mode.before:.5g}", f"{mode.after:.5g}", f"{change:+.4g}", span
            rows.append([str(number), *values, percent(mode.similarity)])
        return rows

    def _repr_html_(self) -> str:
        parts = [table(_HEADINGS, one._rows()) for one in (self, *self.others)]
        facts = {"modes": len(self.modes), "answers": len(parts) if self.others else ""}
        return card("Modification", facts, *parts)

    def __repr__(self) -> str:
        return f"Modification({format_count(len(self.modes), 'mode')})"


_HEADINGS = ("mode", "before (Hz)", "after (Hz)", "change (Hz)", "95 % interval", "similarity")


def _compare_modes(
    before: UpdatedModes,
    after: UpdatedModes,
    changed: ChangedUpdate,
    posterior: Posterior,
    freedom: int | None,
) -> tuple[ModeChange, ...]:
    """Return the changes of the modes, paired by their shapes."""
    first, second = (m.modes.shapes[:, : m.number] for m in (before, after))
    similarity = np.abs(first.T @ (before.model.mass @ second)) ** 2
    pairs = dict(zip(*linear_sum_assignment(similarity, maximize=True), strict=True))
    found = []
    for k in range(before.number):
        m, slope = pairs[k], _differentiate(before, k)
        moved = changed.expand(_differentiate(after, m))
        f, g = float(before.modes.frequency[k]), float(after.modes.frequency[m])
        found.append(
            ModeChange(
                before=f,
                after=g,
                std_before=float(posterior.propagate(slope, f)),
                std_after=float(posterior.propagate(moved, g)),
                std_change=float(posterior.propagate(moved - slope, f)),
                similarity=min(float(similarity[k, m]), 1.0),
                degrees_of_freedom=freedom,
            )
        )
    return tuple(found)


def _differentiate(modes: UpdatedModes, k: int) -> RealArray:
    """Return the derivatives of a frequency in Hz; nan for modes without derivatives."""
    try:
        return modes.differentiate(k).frequency
    except SolverError:
        return np.full(len(modes.values), np.nan)
