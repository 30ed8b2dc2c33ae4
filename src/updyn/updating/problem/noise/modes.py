"""`ModalNoise`: standard deviations of measured frequencies, shapes, damping and scales."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy  # loads scipy.optimize on use; its import is slow
from scipy.special import chdtri

from updyn.arrays import RealArray
from updyn.errors import OptionError, suggest
from updyn.group import is_number
from updyn.updating.problem.modal_rows import KINDS, ModalRows
from updyn.updating.problem.noise.settings import MODAL_SIZES, NOISE_LIMITS

__all__ = ["ASSUMED_OF_MODES", "ModalNoise", "choose_modal_noise"]


#: Standard deviations, as shares, that are assumed if neither the user nor the data give them
#: (Friswell & Mottershead, Finite Element Model Updating in Structural Dynamics, 1995: frequencies
#: to 1 %, shapes to 10 %).
ASSUMED_OF_MODES: Mapping[str, float] = {"frequency": 0.01, "shape": 0.1, "loss_factor": 0.2}
#: Kinds that the user can state.
_STATED = (*ASSUMED_OF_MODES, "scale")


@dataclass(frozen=True, slots=True, eq=False)
class ModalNoise:
    """Standard deviations of measured modes: those of the data, and an added one for each kind.

    The added one is stated, and then replaces those of the data, or s^2 = (sum r^2 + n_0 s_0^2) /
    (n + n_0), with the typical size s_0 (inverse gamma prior; Gelman et al., Bayesian Data
    Analysis, 3rd ed. 2013, section 2.6). For weights, n counts residuals: sizes and unknowns then
    minimise one function. For standard deviations, the leverage of the unknowns reduces n (K. R.
    Koch, Parameter Estimation and Hypothesis Testing in Linear Models, 1999, section 3.6). Typical
    sizes are those assumed, reduced in one ratio if shapes are more exact; larger residuals of
    shapes are errors of the model.
    """

    added: Mapping[str, float] = field(default_factory=lambda: dict(ASSUMED_OF_MODES))
    stated: frozenset[str] = frozenset()
    kind: str = "assumed"
    by_ratio: tuple[str, ...] = ()
    degrees_of_freedom: int | None = None

    @property
    def size_known(self) -> bool:
        """Whether the user states all numbers."""
        return self.stated >= ASSUMED_OF_MODES.keys()

    @property
    def excludes_shapes(self) -> bool:
        """Whether shapes have a stated standard deviation of 1 or more and are not used."""
        return "shape" in self.stated and self.added["shape"] >= 1.0

    def in_units_of_frequency(self) -> ModalNoise:
        """Return the assumed noise in units of that of a frequency; ignores stated numbers."""
        unit = ASSUMED_OF_MODES["frequency"]
        added = {kind: share / unit for kind, share in ASSUMED_OF_MODES.items()}
        return ModalNoise(added, frozenset(added))

    def std(self, rows: ModalRows) -> RealArray:
        """Return the standard deviation of each residual, shape (r,); inf for unused kinds."""
        variance = np.full(len(rows.r), np.inf)
        for number, kind in enumerate(KINDS):
            is_kind = rows.kind == number
            if kind in self.added:
                data_variance = 0.0 if kind in self.stated else rows.std[is_kind] ** 2
                variance[is_kind] = data_variance + self.added[kind] ** 2
        return np.asarray(np.sqrt(variance))

    def without_assumptions(self, rows: ModalRows) -> ModalNoise:
        """Return the noise with no added size where the data state all standard deviations."""
        known = [kind for kind in self._estimated_kinds(rows) if rows.std[rows.of(kind)].all()]
        least = dict.fromkeys(known, NOISE_LIMITS.least_modal_noise)
        return replace(self, added={**self.added, **least})

    def estimate_for_weights(self, rows: ModalRows) -> ModalNoise:
        """Return the noise with sizes that weight residuals in a fit; itself if all are stated."""
        number = {kind: float(rows.freedom(kind)) for kind in self._estimated_kinds(rows)}
        if not number:
            return self
        found = self
        for _ in range(MODAL_SIZES.most_rounds):
            before = dict(found.added)
            found = replace(self, added={**before, **_estimate_sizes(rows, number, before)})
            if _have_settled(found.added, before, number):
                break
        return found

    def refit(self, rows: ModalRows, rest: RealArray) -> ModalNoise:
        """Return the noise estimated from the residuals of a fit; itself if all numbers are stated.

        `rest`, shape (k, n), is the reduced, whitened Jacobian of all other data and priors.
        """
        kinds = self._estimated_kinds(rows)
        if not kinds:
            return self
        found = replace(self, kind="estimated")
        for _ in range(MODAL_SIZES.most_rounds):
            before = dict(found.added)
            leverage = _compute_leverage(rows, found.std(rows), rest)
            spare = {kind: rows.freedom(kind) - leverage[rows.of(kind)].sum() for kind in kinds}
            sizes = _estimate_sizes(rows, spare, before)
            found = replace(found, added={**before, **sizes})
            if _have_settled(sizes, before, kinds):
                break
        least = MODAL_SIZES.typical_weight
        many = [float(spare[kind]) for kind in kinds if spare[kind] >= least]
        short = tuple(
            kind for kind in kinds if spare[kind] < least and not rows.std[rows.of(kind)].all()
        )
        if not many:
            return replace(found, kind="assumed", by_ratio=short)
        few = int(min(many)) if min(many) < NOISE_LIMITS.many_freedoms else None
        rounding = NOISE_LIMITS.least_modal_noise
        if all(found.added[k] == rounding and rows.std[rows.of(k)].all() for k in kinds):
            return replace(found, kind="standard deviations")
        return replace(found, by_ratio=short, degrees_of_freedom=few)

    def _estimated_kinds(self, rows: ModalRows) -> list[str]:
        """Return the kinds of residuals whose size is not stated."""
        return [k for k in self.added if k not in self.stated and rows.of(k).any()]

    def figures(self, rows: ModalRows) -> dict[str, Any]:
        """Return the rms standard deviation of each kind of residual, for the record."""
        std, out = self.std(rows), {}
        for kind in self.added:
            is_kind = rows.of(kind)
            if is_kind.any():
                out[kind] = float(np.sqrt(np.mean(std[is_kind] ** 2)))
        return out


def _have_settled(
    sizes: Mapping[str, float], before: Mapping[str, float], kinds: Iterable[str]
) -> bool:
    """Return whether the sizes of some kinds hardly changed in a round."""
    change = MODAL_SIZES.settled_change
    return all(abs(sizes[kind] - before[kind]) <= change * before[kind] for kind in kinds)


def _compute_leverage(rows: ModalRows, std: RealArray, rest: RealArray) -> RealArray:
    """Return the leverage of the unknowns on each residual, 0 to 1, shape (r,)."""
    J = rows.J / std[:, None]
    whole = np.vstack([J, rest])
    norms = np.linalg.norm(whole, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    _, s, Vt = np.linalg.svd(whole / norms, full_matrices=False)
    is_determined = s > 1e-10 * s[0] if s.size and s[0] > 0.0 else np.zeros(len(s), dtype=np.bool_)
    inner = (J / norms) @ (Vt[is_determined].T / s[is_determined])
    return np.asarray(np.sum(inner**2, axis=1))


def _estimate_sizes(
    rows: ModalRows, number: Mapping[str, float], before: Mapping[str, float]
) -> dict[str, float]:
    """Return the size of each kind for its effective number of residuals."""
    exact = min(1.0, before.get("shape", np.inf) / ASSUMED_OF_MODES["shape"])
    found = {}
    for kind, n in number.items():
        is_kind = rows.of(kind)
        typical = exact * ASSUMED_OF_MODES.get(kind, 1.0)
        found[kind] = _estimate_size(rows.r[is_kind], rows.std[is_kind], float(n), typical)
    return found


def _estimate_size(r: RealArray, std: RealArray, number: float, typical: float) -> float:
    """Return s with sum r^2 / (std^2 + s^2) = number, at least that of rounding."""
    # If the data have no standard deviations, the typical size enters with its weight.
    least, weight = NOISE_LIMITS.least_modal_noise, MODAL_SIZES.typical_weight
    if not std.any():
        squares = float(r @ r) + weight * typical**2
        return max(float(np.sqrt(squares / (number + weight))), least)

    def excess(size: float) -> float:
        return float(np.sum(r**2 / (std**2 + size**2))) - number

    # The standard deviations of the data hold unless the residual contradicts them; less than one
    # degree of freedom cannot.
    if number < 1.0:
        return least
    allowed = float(chdtri(number, MODAL_SIZES.contradiction_probability)) - number
    if excess(least) <= allowed:
        return least
    most = 2.0 * float(np.sqrt(r @ r / number))  # above the size without other deviations
    return float(scipy.optimize.brentq(excess, least, most, xtol=1e-14, rtol=1e-10))


def choose_modal_noise(noise: Any) -> ModalNoise:
    """Return the noise model of modes; None: that of the data plus an estimated number by kind.

    A mapping with ``frequency``, ``shape``, ``loss_factor`` and ``scale`` states these as shares.
    The scale of shapes of unit modal mass is used only if it is stated.
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
