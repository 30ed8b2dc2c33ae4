"""A loss factor that varies with frequency, while the model has a constant one."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

import numpy as np

from updyn.arrays import ComplexArray, NumberArray, RealArray
from updyn.dynamics.affine import AffineSystem, State, Term
from updyn.group import LossTable
from updyn.remedy import Remedy
from updyn.updating.judge.causes.altered import AlteredPart, SystemAlteration, replace_system
from updyn.updating.judge.causes.altering import AlteringFault
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.missing_element import list_directed_places
from updyn.updating.judge.causes.proportional import ProportionalDamping
from updyn.updating.judge.causes.rates import ALL, MATRICES
from updyn.updating.judge.causes.settings import LOSS_EXPONENT
from updyn.updating.problem.parameters import Parameter
from updyn.updating.problem.problem import FRFPart

__all__ = ["LossOverFrequency", "LossPowerLaw"]


#: Number of variants: with a constant storage modulus and without.
_VARIANTS = 2


@dataclass(frozen=True, slots=True)
class LossPowerLaw(SystemAlteration):
    """Multiplication of the loss moduli of groups by (f / `mid_frequency`)^exponent.

    Empty `groups`: all without a loss table. If `causal`, the storage moduli vary as well, by the
    Kramers-Kronig relations.
    """

    groups: tuple[str, ...]
    exponent: float
    mid_frequency: float
    causal: bool = False

    def alter_part(self, part: FRFPart) -> FRFPart:
        """Return the part with these moduli at its lines."""
        system = part.solver.system
        freq = np.unique(np.append(part.frf.freq, 2.0 * part.frf.freq[-1] + 1.0))
        table = LossTable(freq, self.loss_ratio(freq))
        terms = tuple(
            replace(term, table=table) if self.acts_on(term) else term for term in system.terms
        )
        tabled = replace(system, terms=terms)
        if self.causal:
            tabled = CausalSystem.of(tabled, self, [self.acts_on(term) for term in system.terms])
        return replace(part, solver=replace_system(part, tabled))

    def acts_on(self, term: Term) -> bool:
        """Return whether the change applies to the loss factor of a term."""
        is_affected = not self.groups or term.group in self.groups
        return is_affected and term.quantity == "stiffness" and term.table is None

    def loss_ratio(self, freq: RealArray) -> RealArray:
        """Return the factors at some lines; at 0 Hz that of the next line, shape (n,)."""
        return np.asarray(np.exp(self.exponent * _log_frequency_ratio(freq, self.mid_frequency)))

    def storage_change(self, freq: RealArray) -> RealArray:
        """Return the change of the storage modulus in units of loss factor times stiffness."""
        # The storage modulus of (i f)^p is cot(pi p / 2) times its loss modulus (Bagley & Torvik,
        # J. Rheol. 27 (1983) 201); that at `mid_frequency` is part of the stiffness.
        log, p = _log_frequency_ratio(freq, self.mid_frequency), self.exponent
        if not self.causal or abs(p) >= 1.0:
            return np.zeros(len(freq))
        if p == 0.0:
            return np.asarray(2.0 / np.pi * log)
        return np.asarray(np.expm1(p * log) / np.tan(0.5 * np.pi * p))

    def complex_modulus(self, freq: RealArray) -> ComplexArray:
        """Return the complex modulus due to the loss factor, over loss factor times stiffness."""
        return self.storage_change(freq) + 1j * self.loss_ratio(freq)

    def slope(self, freq: RealArray) -> ComplexArray:
        """Return the derivative of `complex_modulus` by the exponent, shape (n,)."""
        low, high = (
            replace(self, exponent=self.exponent + step).complex_modulus(freq)
            for step in (-LOSS_EXPONENT.step, LOSS_EXPONENT.step)
        )
        return np.asarray((high - low) / (2.0 * LOSS_EXPONENT.step))


@dataclass(frozen=True, slots=True, eq=False)
class CausalSystem(AffineSystem):
    """A compiled model in which the storage moduli of the `varying` terms vary with frequency."""

    loss_power: LossPowerLaw | None = None
    varying: tuple[bool, ...] = ()

    @classmethod
    def of(cls, system: AffineSystem, loss_power: LossPowerLaw, varying: Sequence[bool]) -> Self:
        """Return a system with the loss tables of a power law and its storage moduli."""
        return cls(**_field_values(system), loss_power=loss_power, varying=tuple(varying))

    def coefficients(self, state: State, omega: RealArray) -> ComplexArray:
        """Return c_t at i omega + decay, shape (n_terms, n_lines); `omega` in rad/s."""
        out = AffineSystem(**_field_values(self)).coefficients(state, omega)
        at = np.array(self.varying)
        assert self.loss_power is not None
        amount = (state.factor * state.loss)[at, None]
        out[at] += amount * self.loss_power.storage_change(omega / (2.0 * np.pi))
        return out

    def relative(self, at: Iterable[int], omega: RealArray) -> NumberArray:
        """Return the derivatives of c_t by the loss factor over i factor, shape (n_terms, n_f)."""
        chosen = list(at)
        out: NumberArray = AffineSystem(**_field_values(self)).relative(chosen, omega)
        assert self.loss_power is not None
        for t in chosen:
            if self.varying[t]:
                out = out.astype(np.complex128)
                out[t] = -1j * self.loss_power.complex_modulus(omega / (2.0 * np.pi))
        return out


@dataclass(frozen=True, slots=True)
class LossOverFrequency(AlteringFault):
    """The loss factor of a group, or of all groups, is proportional to f^value.

    If `causal`, the storage modulus varies as well (Kramers-Kronig), by about 2 / pi times the loss
    factor for each factor of e in frequency. Groups with a loss table are not tried: their
    variation is given. `mid_frequency` is in Hz; `loss` is the loss factor there, 0 if groups
    differ; `viscous` is viscous damping of the same groups that is not an unknown.
    """

    groups: tuple[str, ...] = ()
    mid_frequency: float = 1.0
    lines: tuple[float, ...] = ()
    loss: float = 0.0
    viscous: tuple[ProportionalDamping, ...] = ()
    causal: bool = False

    kind: ClassVar[str] = "loss-over-frequency"
    distinguishing_test: ClassVar[str] = (
        "A test over a wider band, or of the part alone at several frequencies, would distinguish"
        " them."
    )

    @classmethod
    def propose_faults(cls, evidence: Evidence) -> Iterable[Self]:
        """Yield each loss factor that is unknown or held, and all of them together."""
        lines = _list_lines_above_zero(evidence.part)
        groups_by_name = {
            p.name: tuple(drive.group for drive in p.acts_on)
            for _, p in _list_loss_factors(evidence.part)
        }
        if len(groups_by_name) > 1:
            groups_by_name[f"{ALL}.loss_factor"] = ()
        mid_frequency, n_places = math.sqrt(lines[0] * lines[-1]), _VARIANTS * len(groups_by_name)
        slopes = evidence.slopes_by_rate
        n_viscous_places = len(list(list_directed_places(evidence.frf))) + len(slopes)
        for name, groups in groups_by_name.items():
            viscous = _list_viscous_damping(groups, slopes, n_viscous_places)
            about = (groups, mid_frequency, lines, 0.0, viscous)
            plain = cls((name,), 0.0, *about, n_places=n_places)
            yield plain
            yield replace(plain, value=LOSS_EXPONENT.first, causal=True)

    @property
    def alteration(self) -> LossPowerLaw:
        """The variation of the loss factors."""
        return LossPowerLaw(self.groups, self.value, self.mid_frequency, self.causal)

    def slope(self, evidence: Evidence) -> ComplexArray:
        """Return the derivative of the model's ln H by the exponent."""
        freq, law = evidence.frf.freq, self.alteration
        modulus: ComplexArray | complex = 1j
        if isinstance(evidence.part, AlteredPart):
            earlier = evidence.part.alteration
            if isinstance(earlier, LossPowerLaw):
                law = replace(earlier, exponent=earlier.exponent + self.value)
                modulus = earlier.complex_modulus(freq)
        total = np.zeros(evidence.frf.values.shape, dtype=np.complex128)
        for i, p in _list_loss_factors(evidence.part):
            if not self.groups or {drive.group for drive in p.acts_on} <= set(self.groups):
                total += float(evidence.x[i]) * evidence.slopes_by_unknown[i]
        return np.asarray(total * (law.slope(freq) / modulus)[:, None, None])

    def add_model_figures(self, part: FRFPart, x: RealArray) -> Self:
        """Return the fault with the lines of a part and the loss factor of its model at a point."""
        state, terms = part.state(x), part.solver.system.terms
        losses = {
            float(state.loss[t]) for t, term in enumerate(terms) if self.alteration.acts_on(term)
        }
        loss = losses.pop() if len(losses) == 1 else 0.0
        return replace(self, loss=loss, lines=_list_lines_above_zero(part))

    @property
    def special_cases(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """Viscous damping: exponent 1 or -1 with a constant storage modulus."""
        return tuple(one.key for one in self.viscous)

    def list_similar_faults(self, part: FRFPart) -> Iterable[Fault]:
        """Return the other variant, and viscous damping of the groups with such a loss factor."""
        quantity = "stiffness_damping" if self.value > 0.0 else "mass_damping"
        return [
            replace(self, causal=not self.causal),
            *(one for one in self.viscous if one.channels[0].endswith(f".{quantity}")),
        ]

    def is_plausible(self) -> bool:
        """Return whether the exponent is not 0 and not above that of a solid."""
        return 0.0 < abs(self.value) <= LOSS_EXPONENT.most

    @property
    def _group_text(self) -> str:
        if not self.groups:
            return "all groups"
        names = ", ".join(repr(name) for name in self.groups)
        return f"the group{'s' * (len(self.groups) > 1)} {names}"

    def statement(self) -> str:
        """Return a sentence with the groups and the range of their loss factor."""
        trend = "rises" if self.value > 0.0 else "falls"
        low, high = self.lines[0], self.lines[-1]
        ends = self.alteration.loss_ratio(np.array([low, high]))
        if self.loss:
            first, last = self.loss * ends
            extent = f"from {first:.3g} at {low:.4g} Hz to {last:.3g} at {high:.4g} Hz"
        else:
            extent = f"by a factor of {ends[1] / ends[0]:.3g} from {low:.4g} to {high:.4g} Hz"
        stiffer = ""
        if self.causal and self.loss:
            change = self.loss * np.ptp(self.alteration.storage_change(np.array([low, high])))
            stiffer = f", and its stiffness rises by {100.0 * change:.2g} %"
        return (
            f"The loss factor of {self._group_text} {trend} with frequency: {extent}, as"
            f" f^{self.value:.2f}{stiffer}; in the model it is constant."
        )

    @property
    def remedy(self) -> Remedy:
        """Advice to the user."""
        freq = self._table_lines
        relative = _round_to_table(self.alteration.loss_ratio(freq))
        named = list(self.groups) or [ALL]
        settings: dict[str, object] = {"groups": named if len(named) > 1 else named[0]}
        if self.loss:
            settings["loss_factor"] = float(f"{self.loss:.3g}")
        settings["loss_table"] = [freq.tolist(), relative.tolist()]
        stiffer = " No table describes the change of the stiffness." if self.causal else ""
        return Remedy.table(
            "Add this loss table to the model (Model.with_damping in Python):",
            "[[damping]]",
            settings,
            f"A test of the part alone gives a better table.{stiffer}",
        )

    @property
    def _table_lines(self) -> RealArray:
        """Frequencies of few digits, from below the lines to the next one above."""
        # A search uses some of the lines only; the highest line of the data may not be among them.
        low, (last, high) = self.lines[0], self.lines[-2:]
        rounding = 0.5 * 10.0 ** (1 - LOSS_EXPONENT.table_digits)
        freq = np.geomspace(
            low * (1.0 - rounding), high * (high / last + rounding), LOSS_EXPONENT.table_lines
        )
        return _round_to_table(freq)


def _round_to_table(values: RealArray) -> RealArray:
    return np.array([float(f"{one:.{LOSS_EXPONENT.table_digits}g}") for one in values])


def _field_values(system: AffineSystem) -> dict[str, Any]:
    """Return the fields of a compiled model by name."""
    return {one.name: getattr(system, one.name) for one in fields(AffineSystem) if one.init}


def _list_lines_above_zero(part: FRFPart) -> tuple[float, ...]:
    return tuple(part.frf.freq[part.frf.freq > 0.0].tolist())


def _list_loss_factors(part: FRFPart) -> Sequence[tuple[int, Parameter]]:
    """Return the unknown loss factors of groups without a loss table, with their positions."""
    system = part.solver.system
    return [
        (i, p)
        for i, p in enumerate(part.coordinates.parameters)
        if p.value_of == "loss_factor"
        and not any(_has_loss_table(system, d.group) for d in p.acts_on)
    ]


def _list_viscous_damping(
    groups: Sequence[str], missing: Container[str], n_places: int
) -> tuple[ProportionalDamping, ...]:
    """Return the viscous damping of a group, or else of all groups, among missing coefficients."""
    if len(groups) > 1:
        return ()
    group, found = groups[0] if groups else ALL, []
    for quantity in MATRICES:
        names = (f"{group}.{quantity}", f"{ALL}.{quantity}")
        found += [name for name in names if name in missing][:1]
    return tuple(ProportionalDamping((name,), n_places=n_places) for name in found)


def _has_loss_table(system: AffineSystem, group: str) -> bool:
    return system.terms[system.find(group, "loss_factor")].table is not None


def _log_frequency_ratio(freq: RealArray, mid_frequency: float) -> RealArray:
    """Return ln(f / middle), shape (n,); at 0 Hz that of the next line."""
    moving = freq[freq > 0.0]
    lowest = moving.min() if moving.size else mid_frequency
    return np.asarray(np.log(np.maximum(freq, lowest) / mid_frequency))
