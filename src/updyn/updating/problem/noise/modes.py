"""`ModalNoise`: how exact measured frequencies, shapes, loss factors and scales of modes are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import chdtri

from updyn.errors import OptionError, suggest
from updyn.group import is_number
from updyn.updating.problem.modal_rows import KINDS, ModalRows

__all__ = ["ASSUMED_OF_MODES", "ModalNoise", "choose_modal_noise"]

_Real = NDArray[np.float64]

#: Standard deviations that are assumed where neither the user nor the data say them, as shares
#: (Friswell & Mottershead, Finite Element Model Updating in Structural Dynamics, 1995: frequencies
#: to 1 %, shapes to 10 %).
ASSUMED_OF_MODES: Mapping[str, float] = {"frequency": 0.01, "shape": 0.1, "loss_factor": 0.2}
#: What the user can state.
_STATED = (*ASSUMED_OF_MODES, "scale")
#: Shares below this are rounding.
_SMALLEST = 1e-8
#: A spread is estimated from as many residuals as are left by the unknowns: at least so many, and
#: this share of them.
_SPARE, _SPARE_SHARE = 2.0, 0.2
#: Of fewer residuals intervals are those of Student's distribution.
_MANY = 30
#: The common spread of those of which fewer are left needs so many.
_SPARE_TOGETHER = 1.0
_ROUNDS, _SETTLED = 100, 1e-4
#: Probability of a residual that contradicts the standard deviations that the data state.
_CONTRADICTED = 0.05
#: Largest spread that a search for it looks at, times the residuals' rms.
_WIDEST = 1e3


@dataclass(frozen=True, slots=True, eq=False)
class ModalNoise:
    """Standard deviations of measured modes: those that the data state, and what is added to them.

    What is added is one number for each kind of residual: stated by the user (then the data's own
    do not count), or estimated from the residual. The sizes of several kinds of error are told
    apart by the residuals that the unknowns leave of each kind: the sum of squares, each over its
    variance, is as large as their number less what the unknowns took up of it (K. R. Koch,
    Parameter Estimation and Hypothesis Testing in Linear Models, 1999, section 3.6: the estimate of
    variance components by their redundancies).

    Attributes
    ----------
    added : mapping of str to float
        By kind of residual, as a share.
    stated : frozenset of str
        Kinds whose number the user states.
    size_known : bool
        Whether no number is estimated or assumed.
    kind : str
        How it is known, for the record.
    by_ratio : tuple of str
        Kinds of which too few residuals are left to see their size, so that it is taken in the
        usual ratio to that of the others, or as assumed.
    degrees_of_freedom : int or None
        Of the number that was estimated from the fewest residuals, where they are few.
    """

    added: Mapping[str, float] = field(default_factory=lambda: dict(ASSUMED_OF_MODES))
    stated: frozenset[str] = frozenset()
    kind: str = "assumed"
    by_ratio: tuple[str, ...] = ()
    degrees_of_freedom: int | None = None

    @property
    def size_known(self) -> bool:
        """Whether the user states all of it."""
        return self.stated >= ASSUMED_OF_MODES.keys()

    def levelled(self) -> ModalNoise:
        """Return it in units of a frequency's, as assumed; what is stated does not count."""
        unit = ASSUMED_OF_MODES["frequency"]
        added = {kind: share / unit for kind, share in ASSUMED_OF_MODES.items()}
        return ModalNoise(added, frozenset(added))

    def std(self, rows: ModalRows) -> _Real:
        """Return the standard deviation of each residual, shape (r,); inf of a kind not used.

        Parameters
        ----------
        rows : ModalRows
            The residuals.
        """
        variance = np.full(len(rows.r), np.inf)
        for number, kind in enumerate(KINDS):
            mine = rows.kind == number
            if kind in self.added:
                own = 0.0 if kind in self.stated else rows.std[mine] ** 2
                variance[mine] = own + self.added[kind] ** 2
        return np.asarray(np.sqrt(variance))

    def refit(self, rows: ModalRows, rest: _Real) -> ModalNoise:
        """Return it with its numbers estimated from residuals.

        Parameters
        ----------
        rows : ModalRows
            The residuals where a fit ended.
        rest : ndarray of float, shape (k, n)
            Reduced Jacobian of all else that is known of the unknowns, whitened.

        Returns
        -------
        ModalNoise
            Itself where all numbers are stated.
        """
        sought = [k for k in self.added if k not in self.stated and (rows.of(k)).any()]
        if not sought:
            return self
        found = replace(self, kind="estimated")
        for _ in range(_ROUNDS):
            before = dict(found.added)
            leverage = _leverage(rows, found.std(rows), rest)
            sizes = _estimated(rows, leverage, sought, before)
            if sizes.spare is None:
                return replace(self, kind="assumed", by_ratio=sizes.by_ratio)
            few = int(sizes.spare) if sizes.spare < _MANY else None
            found = replace(
                found,
                added={**before, **sizes.added},
                by_ratio=sizes.by_ratio,
                degrees_of_freedom=few,
            )
            if all(abs(sizes.added[k] - before[k]) <= _SETTLED * before[k] for k in sought):
                break
        if all(found.added[k] == _SMALLEST and rows.std[rows.of(k)].all() for k in sought):
            return replace(found, kind="standard deviations", degrees_of_freedom=None)
        return found

    def figures(self, rows: ModalRows) -> dict[str, Any]:
        """Return the typical standard deviation of each kind of residual, for the record.

        Parameters
        ----------
        rows : ModalRows
            The residuals.
        """
        std, out = self.std(rows), {}
        for kind in self.added:
            mine = rows.of(kind)
            if mine.any():
                out[kind] = float(np.sqrt(np.mean(std[mine] ** 2)))
        return out


def _leverage(rows: ModalRows, std: _Real, rest: _Real) -> _Real:
    """Return what the unknowns take up of each residual, shape (r,), 0 to 1."""
    J = rows.J / std[:, None]
    whole = np.vstack([J, rest])
    norms = np.linalg.norm(whole, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    _, s, Vt = np.linalg.svd(whole / norms, full_matrices=False)
    seen = s > 1e-10 * s[0] if s.size and s[0] > 0.0 else np.zeros(len(s), dtype=np.bool_)
    inner = (J / norms) @ (Vt[seen].T / s[seen])
    return np.asarray(np.sum(inner**2, axis=1))


@dataclass(frozen=True, slots=True)
class _Sizes:
    """What the residuals say of their sizes.

    Attributes
    ----------
    added : dict of str to float
        The number of each kind.
    by_ratio : tuple of str
        Kinds that are taken in the usual ratio.
    spare : float or None
        Fewest residuals that a number was estimated from, less what the unknowns took up; None
        where none was.
    """

    added: dict[str, float]
    by_ratio: tuple[str, ...]
    spare: float | None


def _estimated(
    rows: ModalRows, leverage: _Real, sought: list[str], before: Mapping[str, float]
) -> _Sizes:
    """Return what the residuals say of the size of each kind."""
    added: dict[str, float] = {}
    short: list[str] = []
    spares: list[float] = []
    for kind in sought:
        mine = rows.of(kind)
        number = rows.freedom(kind)
        spare = number - float(leverage[mine].sum())
        if spare < max(_SPARE, _SPARE_SHARE * number):
            short.append(kind)
            continue
        spares.append(spare)
        added[kind] = _size(rows.r[mine], rows.std[mine], np.ones(int(mine.sum())), spare)
    if not short:
        return _Sizes(added, (), min(spares))
    # Of these there are too few: they keep the ratio that is assumed, to each other or to the rest.
    at = np.logical_or.reduce([rows.of(kind) for kind in short])
    spare = sum(map(rows.freedom, short)) - float(leverage[at].sum())
    if spare >= _SPARE_TOGETHER:
        unit = np.array([ASSUMED_OF_MODES.get(KINDS[k], 1.0) for k in rows.kind[at]])
        share = _size(rows.r[at], rows.std[at], unit, spare)
        spares.append(spare)
    elif added:
        share = float(np.median([added[k] / ASSUMED_OF_MODES.get(k, 1.0) for k in added]))
    else:
        return _Sizes({kind: before[kind] for kind in short}, tuple(short), None)
    for kind in short:
        added[kind] = max(share * ASSUMED_OF_MODES.get(kind, 1.0), _SMALLEST)
    return _Sizes(added, tuple(short), min(spares))


def _size(r: _Real, std: _Real, unit: _Real, spare: float) -> float:
    """Return s for which the sum of r^2 / (std^2 + (s unit)^2) is `spare`; 0 is rounding."""

    def excess(size: float) -> float:
        return float(np.sum(r**2 / (std**2 + (size * unit) ** 2))) - spare

    # What the data state holds unless the residual contradicts it.
    allowed = max(float(chdtri(spare, _CONTRADICTED)) - spare, 0.0) if std.any() else 0.0
    if excess(_SMALLEST) <= allowed:
        return _SMALLEST
    high = max(_WIDEST * float(np.max(np.abs(r) / unit)), 10.0 * _SMALLEST)
    return float(brentq(excess, _SMALLEST, high, xtol=1e-14, rtol=1e-10))


def choose_modal_noise(noise: Any) -> ModalNoise:
    """Choose how exact modes are.

    Parameters
    ----------
    noise : None or mapping
        None: standard deviations that come with the modes, and beyond them one number for each kind
        of residual, estimated. A mapping with ``frequency``, ``shape``, ``loss_factor`` and
        ``scale`` states them, as shares: a frequency to 0.1 % is 0.001. The scale of shapes of unit
        modal mass counts only where it is stated.

    Raises
    ------
    OptionError
        If it is of another kind, a key is not known, or a number is not above 0.
    """
    if noise is None:
        return ModalNoise()
    if not isinstance(noise, Mapping):
        raise OptionError(
            f"noise {noise!r}: modes take a table with some of {', '.join(_STATED)}", key=("noise",)
        )
    stated: dict[str, float] = {}
    for key, value in noise.items():
        if key not in _STATED:
            raise OptionError(
                f"noise: no key {key!r} for modes; {suggest(str(key), _STATED)}", key=("noise", key)
            )
        if not is_number(value) or not 0 < value < np.inf:
            raise OptionError(
                f"noise: {key} = {value!r}; expected a number above 0", key=("noise", key)
            )
        stated[key] = float(value)
    known = stated.keys() >= ASSUMED_OF_MODES.keys()
    return ModalNoise(
        {**ASSUMED_OF_MODES, **stated}, frozenset(stated), "stated" if known else "assumed"
    )
