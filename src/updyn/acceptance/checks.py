"""Requirements of the limits on compared modes, by kind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from updyn.acceptance.comparison import ModesCompared, PairedMode
from updyn.acceptance.limits import AcceptanceLimits
from updyn.acceptance.requirement import FAIL, OPEN, PASS, Requirement
from updyn.acceptance.similarity import ShapeSet, probability_between, shrink

__all__ = ["Checks"]

_NO_MASSES = "effective masses are not known"


@dataclass(frozen=True, slots=True, eq=False)
class Checks:
    """The requirements of `limits` on compared modes.

    `fundamental` are numbers of measured modes from 1.
    """

    compared: ModesCompared
    limits: AcceptanceLimits
    fundamental: tuple[int, ...]
    least_probability: float | None = None

    def list_requirements(self) -> Iterator[Requirement]:
        """Yield the requirements by measured mode, then those on the model."""
        pairs = {pair.measured: pair for pair in self.compared.pairs}
        for k in range(len(self.compared.measured)):
            if k not in pairs:
                yield self._without_pair(k)
                continue
            pair = pairs[k]
            yield self._begin("pair", pair, outcome=PASS)
            yield from self._check_frequency(pair)
            yield from self._check_shape(pair)
        yield from self._check_unmeasured()
        yield from self._check_mass()

    def _begin(
        self, kind: str, pair: PairedMode, outcome: str = OPEN, note: str = ""
    ) -> Requirement:
        measured = float(self.compared.measured.frequency[pair.measured])
        computed = float(self.compared.computed.frequency[pair.computed])
        return Requirement(kind, outcome, measured, computed, note=note)

    def _without_pair(self, k: int) -> Requirement:
        frequency = float(self.compared.measured.frequency[k])
        return Requirement("pair", FAIL, frequency, note="the model has no such mode")

    # -- classes of modes ------------------------------------------------------------------------
    def _class_of(self, pair: PairedMode) -> str | None:
        """Return the class of a mode; None if effective masses are needed and not known."""
        members = [pair.measured] if pair.subspace is None else pair.subspace.measured.tolist()
        if any(k + 1 in self.fundamental for k in members):
            return "fundamental"
        if self.limits.effective_mass is None:
            return "other"
        masses = self.compared.masses
        if masses is None:
            return None
        is_major = masses.largest[pair.computed] > self.limits.effective_mass
        return "major" if is_major else "other"

    def _decide_by_class(
        self, what: str, pair: PairedMode, measure: Callable[[float], Requirement]
    ) -> Iterator[Requirement]:
        """Yield the requirement with the limit of the class of its mode, if there is one.

        `measure` returns the requirement for a limit.
        """
        mode_class = self._class_of(pair)
        bounds = [self.limits.of_class(what, name) for name in _candidates(mode_class)]
        stated = [self._decide(measure(limit)) for limit in bounds if limit is not None]
        if not stated:
            return
        outcomes = {one.outcome for one in stated} | {PASS for limit in bounds if limit is None}
        if len(outcomes) > 1:
            yield stated[0].left_open(f"{_NO_MASSES}, which decide the limit")
            return
        note = f"{mode_class or 'possibly major'} mode" if mode_class != "other" else ""
        yield replace(stated[0], note="; ".join(filter(None, [stated[0].note, note])))

    def _decide(self, one: Requirement) -> Requirement:
        return one.decided(self.least_probability)

    # -- frequencies and shapes --------------------------------------------------------------------
    def _check_frequency(self, pair: PairedMode) -> Iterator[Requirement]:
        compared = self.compared
        one = self._begin("frequency", pair)
        ratio = one.computed / one.measured
        noise = ratio * compared.std_frequency[pair.measured] / one.measured
        spread = compared.spreads[pair.computed].frequency / one.measured
        both = float(np.hypot(noise, np.linalg.norm(spread)))

        def measure(limit: float) -> Requirement:
            odds = [probability_between(ratio - 1.0, std, limit) for std in (both, noise)]
            return replace(
                one,
                value=abs(ratio - 1.0),
                limit=limit,
                probability=odds[0],
                probability_as_delivered=odds[1],
            )

        yield from self._decide_by_class("frequency", pair, measure)

    def _check_shape(self, pair: PairedMode) -> Iterator[Requirement]:
        why = self._why_no_shapes(pair)
        if why:
            for kind in ("mac", "mac_off", "cross", "cross_off"):
                if self.limits.stated.keys() & {kind, f"{kind}_major", f"{kind}_fundamental"}:
                    yield self._begin(kind, pair, note=why)
            return
        plain = self.compared.plain
        yield from self._decide_by_class("mac", pair, self._measure_pair("mac", pair, plain))
        if self.limits.mac_off is not None:
            yield self._decide(self._measure_others("mac_off", pair, plain, self.limits.mac_off))
        yield from self._check_cross(pair)

    def _why_no_shapes(self, pair: PairedMode) -> str:
        if not self.compared.measured.has_shapes:
            return "no shapes were measured"
        if len(self.compared.measured.dofs) < 2:
            return "one sensor cannot distinguish shapes"
        if pair.subspace is not None and pair.subspace.vacuous:
            return "no more sensors than close modes"
        return ""

    def _measure_pair(
        self, kind: str, pair: PairedMode, shapes: tuple[ShapeSet, ShapeSet]
    ) -> Callable[[float], Requirement]:
        """Return a function from a limit to the requirement on the similarity of a pair."""
        power = 2 if kind == "mac" else 1
        principal = self.compared.principal_pair(pair, shapes)
        note = "" if pair.subspace is None else "of the subspaces of close modes"
        one = self._begin(kind, pair, note=note)

        def measure(limit: float) -> Requirement:
            cosine = limit ** (1.0 / power)
            return replace(
                one,
                value=principal.cosine**power,
                limit=limit,
                probability=principal.probability(cosine, with_unknowns=True),
                probability_as_delivered=principal.probability(cosine, with_unknowns=False),
            )

        return measure

    def _measure_others(
        self, kind: str, pair: PairedMode, shapes: tuple[ShapeSet, ShapeSet], limit: float
    ) -> Requirement:
        """Return the requirement on the similarity of a measured mode with other modes."""
        others, k = self.compared.others(pair), pair.measured
        one = replace(self._begin(kind, pair), limit=limit)
        if not len(others):
            return replace(one, value=0.0, probability=1.0, probability_as_delivered=1.0)
        power = 2 if kind == "mac_off" else 1
        sizes = np.abs(shapes[0].cosines(shapes[1])[others, k])
        worst = int(np.argmax(sizes))
        frequency = self.compared.computed.frequency[self.compared.compared[others[worst]]]
        bound = limit ** (1.0 / power)
        odds = [
            self._probability_of_others(pair, shapes, bound, with_unknowns=each)
            for each in (True, False)
        ]
        return replace(
            one,
            value=float(sizes[worst]) ** power,
            probability=odds[0],
            probability_as_delivered=odds[1],
            note=f"most with the mode of the model at {frequency:#.5g} Hz",
        )

    def _probability_of_others(
        self,
        pair: PairedMode,
        shapes: tuple[ShapeSet, ShapeSet],
        bound: float,
        *,
        with_unknowns: bool,
    ) -> float:
        """Return the probability that all cosines with other modes are below a bound."""
        cosines = shapes[0].cosines(shapes[1])
        std = shapes[0].std_of_cosines(shapes[1], with_unknowns=with_unknowns)
        is_other = np.zeros(cosines.shape, dtype=np.bool_)
        for each in self.compared.pairs:
            is_other[self.compared.others(each), each.measured] = True
        cosines[is_other], std[is_other] = shrink(cosines[is_other], std[is_other])
        at = self.compared.others(pair), pair.measured
        # Errors of one measured mode along different modes are nearly independent.
        odds = [
            probability_between(*each, bound) for each in zip(cosines[at], std[at], strict=True)
        ]
        return float(np.prod(odds))

    def _check_cross(self, pair: PairedMode) -> Iterator[Requirement]:
        limit, limit_off = self.limits.cross, self.limits.cross_off
        if limit is None and limit_off is None:
            return
        reduced = self.compared.reduced_mass
        if isinstance(reduced, str):
            for kind in ("cross", "cross_off"):
                if getattr(self.limits, kind) is not None:
                    yield self._begin(kind, pair, note=reduced)
            return
        shapes, at = self.compared.mass_weighted, self.compared.position(pair.computed)
        if limit is not None:
            one = self._decide(self._measure_pair("cross", pair, shapes)(limit))
            yield _with_error(one, reduced.error_of_mass(at), 1.0 - limit)
        if limit_off is not None:
            one = self._decide(self._measure_others("cross_off", pair, shapes, limit_off))
            error = reduced.error_between(at, self.compared.others(pair))
            yield _with_error(one, error, limit_off)

    # -- effective masses ------------------------------------------------------------------------
    def _check_unmeasured(self) -> Iterator[Requirement]:
        """Yield a requirement for each major mode of the model that is not measured."""
        masses, least = self.compared.masses, self.limits.effective_mass
        if least is None or masses is None:
            return
        for j in self.compared.find_unmeasured():
            if masses.largest[j] > least:
                reason = "not measured" if j in self.compared.seen else "no sensor sees it"
                note = f"{reason}: {masses.text(j)}"
                frequency = float(self.compared.computed.frequency[j])
                yield Requirement("measured", OPEN, computed=frequency, note=note)

    def _check_mass(self) -> Iterator[Requirement]:
        limit, masses = self.limits.mass_met, self.compared.masses
        if limit is None:
            return
        if masses is None:
            yield Requirement("mass_met", OPEN, note=_NO_MASSES)
            return
        paired = [pair.computed for pair in self.compared.pairs]
        for d, name in enumerate(masses.directions):
            value = float(masses.shares[paired, d].sum())
            changes = [self.compared.computed.spread_mass(j, name) for j in paired]
            std = float(np.linalg.norm(np.sum(changes, axis=0))) if changes else 0.0
            # The share is at most 1; a normal distribution about it is enough near a limit.
            odds = probability_between(1.0 - value, std, 1.0 - limit)
            one = Requirement(
                "mass_met", OPEN, np.nan, np.nan, value, limit, odds, float(value >= limit)
            )
            yield replace(self._decide(one), note=f"along {name}")


def _candidates(mode_class: str | None) -> tuple[str, ...]:
    """Return the classes whose limits may apply, the strictest first."""
    return ("major", "other") if mode_class is None else (mode_class,)


def _with_error(one: Requirement, error: float, most: float) -> Requirement:
    """Return a requirement with the error of the reduced mass; not decidable if it is too large."""
    noted = replace(one, note="; ".join(filter(None, [f"reduction error {error:.3f}", one.note])))
    if error <= most:
        return noted
    return noted.left_open("the reduction error is too large")
