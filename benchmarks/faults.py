"""How often seeded faults of the data are found, rightly named, and undone.

Structures are those of `structures.py`, started from models that are off by up to 30 % in stiffness
and 13 % in mass, without damping where it is sought; data have 1 % of proportional noise and a
floor of a thousandth of the rms. Each draw seeds one fault at a random place by a random amount.
Of the measured beam (`measured.py`) the data are those of the test, on every twentieth line, with
the fault put in; the truth is what a fit to them says without it. Its torsion mode, which the model
does not have, is there in any case.

- before: `updyn.diagnose` names it, before any fit.
- after: so does the result of an update of the faulty data.
- repaired: of those found before, `repair` gives data to which an update finds the truth (all
  unknowns within four bounds of Cramer and Rao), of those draws in which it finds it from the data
  without the fault. An exponential window takes information out of the data, and nobody says how
  long it was: there the bounds of the data through it, its decay being unknown, too, count where
  they are larger; `--strict`: they do not.
- false: other faults named.
- s; fit, s: how long the look before any fit and the fit of the faulty data took (the fit in
  processor time), medians.

Faults that all unknowns together can imitate are seeded where the masses are known (a common
factor), and one stiffness (a scaled frequency axis); `--free`: all the same. A fault counts as
named, too, if the statement lists it as one that the data cannot distinguish from the first, or if
a spring to the ground is stated as a support.

`--out FILE` keeps every draw as a line of JSON; draws that are there are not made again.
`--repairs-only` leaves out the fit of the faulty data, which is by far the longest.
`--odds` prints, for moved sensors, low-passes and scaled axes, the odds of the fault that was
seeded against none, by fits that begin at the truth: whether the data can tell.

    python benchmarks/faults.py [--structures chain,...] [--faults sign,...] [--draws 20]
        [--before-only | --repairs-only | --odds] [--strict] [--out draws.jsonl] [--workers 1]
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import structures
from kept import Kept
from measured import Measured, measured_beam

import updyn
from updyn.frf import FRF, QUANTITIES
from updyn.model import Group, Model
from updyn.updating.judge.causes.altered import AlteredPart, compute_log_ratio
from updyn.updating.judge.causes.candidates import has_small_residual
from updyn.updating.judge.causes.catalogue import CAUSES
from updyn.updating.judge.causes.data_alone import with_variance
from updyn.updating.judge.causes.diagnosis import weight_by_noise
from updyn.updating.judge.causes.element import AddedElement, ElementVectors
from updyn.updating.judge.causes.evidence import Evidence, stack_real_imag
from updyn.updating.judge.causes.fault import Fault
from updyn.updating.judge.causes.loss_over_frequency import LossOverFrequency
from updyn.updating.judge.causes.missing_mass import MissingMass
from updyn.updating.judge.causes.missing_spring import MissingSpring
from updyn.updating.judge.causes.missing_viscous import MissingViscous
from updyn.updating.judge.causes.proportional import ProportionalDamping
from updyn.updating.judge.causes.rates import RayleighIncrement, list_fixed_coefficients
from updyn.updating.judge.causes.reduced import choose_trial_models
from updyn.updating.judge.causes.trial import free_held_quantities, raise_loss_factors, run_trial
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.parameters import ParameterSet
from updyn.updating.problem.problem import FRFPart

NOISE = structures.Noise(0.01, 1e-3)
BEAM = "beam"
OFF = 0.3 / 0.7
#: Share of the largest FRF below which one is rounding.
ROUNDING = 1e-9
#: Lines on which the search looks at faults, and the logarithm of the odds from which one is found.
LINES, FOUND = 60, 2.0
#: Least part of a change of the model (rms), in units of the noise, that unknowns do not imitate.
SEEN_CHANGE = 2.0
#: The same of a change that all values have a share in: 400 of them have odds of e^40 at 0.5.
SPREAD_CHANGE = 0.5
Finding = tuple[str, tuple[str, ...]]
Bench = structures.Bench | Measured


@dataclass(frozen=True, eq=False)
class Seeded:
    """Data with a fault, the same without, and how it is rightly named."""

    faulty: FRF
    sound: FRF
    kind: str
    channels: tuple[str, ...] = ()
    changed: Callable[[Model], Model] = lambda model: model  # what is wrong with the model instead
    decay: float = 0.0  # of a window, in 1/s
    value: float = 0.0  # of the fault, where `--odds` is to know it
    fault: Fault | None = None  # itself, where kind, channels and value do not say it all


def bench_of(name: str) -> Bench:
    return measured_beam() if name == BEAM else structures.bench(name)


def plain(dofs) -> list[str]:
    return [str(abs(dof)) for dof in dofs]


def sensor(frf: FRF, rng: np.random.Generator) -> tuple[int, str]:
    i = int(rng.integers(len(frf.responses)))
    return i, plain(frf.responses)[i]


def times(frf: FRF, factor: np.ndarray, row: int | None = None) -> FRF:
    """Return data with the factor over the lines on one response, or on all."""
    values = frf.values.copy()
    at = slice(None) if row is None else slice(row, row + 1)
    values[:, at] *= factor[:, None, None]
    return replace(frf, values=values)


def quantity(bench, frf, rng):
    """Data of another quantity, whose noise has its floor in that quantity."""
    other = str(rng.choice([q for q in QUANTITIES if q != frf.quantity]))
    sound = frf.converted(other)
    if not isinstance(bench, Measured):
        sound = NOISE.added(bench.case.clean.converted(other), rng)
    return Seeded(replace(sound, quantity=frf.quantity), sound, "quantity")


def quantity_of_one(bench, frf, rng):
    """One sensor of another kind among the others, with its own floor of noise."""
    i, label = sensor(frf, rng)
    other = str(rng.choice([q for q in QUANTITIES if q != frf.quantity]))
    factor = (2j * np.pi * frf.freq) ** (QUANTITIES[other] - QUANTITIES[frf.quantity])
    clean = frf if isinstance(bench, Measured) else bench.case.clean
    own = times(clean.select(responses=[clean.responses[i]]), factor)
    if not isinstance(bench, Measured):
        own = NOISE.added(own, rng)
    values = frf.values.copy()
    values[:, [i]] = own.values
    faulty = replace(frf, values=values)
    return Seeded(faulty, times(faulty, 1.0 / factor, i), "quantity", (label,))


def unit(bench, frf, rng):
    factor = float(rng.choice([9.80665, 1 / 9.80665, 1e3, 1 / 0.0254, 4.4482216152605]))
    return Seeded(times(frf, np.full(len(frf.freq), factor)), frf, "scale")


def sign(bench, frf, rng):
    i, label = sensor(frf, rng)
    return Seeded(times(frf, -np.ones(len(frf.freq)), i), frf, "sign", (label,))


def swapped(bench, frf, rng):
    a, b = rng.choice(len(frf.responses), 2, replace=False)
    values = frf.values.copy()
    values[:, [a, b]] = values[:, [b, a]]
    names = plain(frf.responses)
    return Seeded(replace(frf, values=values), frf, "swapped", tuple(sorted((names[a], names[b]))))


def moved(bench, frf, rng):
    """The neighbouring node, or another direction, of a random sensor."""
    from updyn.updating.judge.causes.places import iter_sensor_places

    part = FRFPart.build(bench.case.true, frf, bench.sought(bench.case.true))
    pairs = list(iter_sensor_places(part))
    if not pairs:
        return None
    here, there = pairs[int(rng.integers(len(pairs)))]
    clean = bench.case.clean
    names = [there if str(abs(d)) == str(abs(here)) else d for d in clean.responses]
    elsewhere = updyn.response(bench.case.true, clean.freq, names, clean.references, clean.quantity)
    drawn = NOISE.added(elsewhere, rng)
    return Seeded(
        replace(drawn, responses=frf.responses), drawn, "moved", (str(abs(here)), str(there))
    )


def force_moved(bench, frf, rng):
    """A force acts at a sensor, at a neighbouring node, or in another direction than stated."""
    from updyn.updating.judge.causes.places import iter_force_places

    part = FRFPart.build(bench.case.true, frf, bench.sought(bench.case.true))
    pairs = list(iter_force_places(part))
    if not pairs:
        return None
    here, there = pairs[int(rng.integers(len(pairs)))]
    clean = bench.case.clean
    names = [there if str(abs(d)) == str(abs(here)) else d for d in clean.references]
    elsewhere = updyn.response(bench.case.true, clean.freq, clean.responses, names, clean.quantity)
    drawn = NOISE.added(elsewhere, rng)
    channels = (f"force {abs(here)}", f"force {there}")
    return Seeded(replace(drawn, references=frf.references), drawn, "moved", channels)


def turned(bench, frf, rng):
    """A sensor with two directions or more is turned by 10 to 45 degrees, or by 90."""
    from updyn.updating.judge.causes.turned import TurnedSensor, list_rotation_axes

    axes = list_rotation_axes(frf.responses)
    if not axes:
        return None
    axis = str(axes[int(rng.integers(len(axes)))])
    angle = float(rng.choice([-1, 1]) * rng.choice([rng.uniform(10.0, 45.0), 90.0], p=[0.8, 0.2]))
    return Seeded(TurnedSensor((axis,), -angle).repair(frf), frf, "turned", (axis,))


def calibration(bench, frf, rng):
    i, label = sensor(frf, rng)
    factor = np.exp(rng.choice([-1, 1]) * rng.uniform(0.08, 0.3))
    return Seeded(times(frf, np.full(len(frf.freq), factor), i), frf, "calibration", (label,))


def common(bench, frf, rng):
    factor = np.exp(rng.choice([-1, 1]) * rng.uniform(0.08, 0.3))
    return Seeded(times(frf, np.full(len(frf.freq), factor)), frf, "calibration")


def delay(bench, frf, rng):
    i, label = sensor(frf, rng)
    late = rng.uniform(0.05, 0.5) / frf.freq[-1]
    return Seeded(times(frf, np.exp(-2j * np.pi * frf.freq * late), i), frf, "delay", (label,))


def frequency_scale(bench, frf, rng):
    scale = np.exp(rng.choice([-1, 1]) * rng.uniform(0.01, 0.04))
    stretched = replace(frf, freq=frf.freq / scale)
    return Seeded(stretched, frf, "frequency-scale", value=float(np.log(scale)))


def low_pass(bench, frf, rng):
    i, label = sensor(frf, rng)
    corner = frf.freq[-1] * rng.uniform(0.5, 3.0)
    passed = times(frf, 1.0 / (1.0 + 1j * frf.freq / corner), i)
    value = 1.0 / (2.0 * np.pi * corner)
    return Seeded(passed, frf, "low-pass", (label,), value=value)


def conjugated(bench, frf, rng):
    return Seeded(replace(frf, values=frf.values.conj()), frf, "non-causal")


def window(bench, frf, rng):
    """At s = i omega + a, s^2 M is that of a mass with damping 2 a M on a spring a^2 M."""
    rate = np.pi * frf.freq[-1] * rng.uniform(0.003, 0.01)
    groups = {}
    for name, group in bench.case.true.groups.items():
        if group.mass is not None:
            groups[f"{name}, window"] = Group(rate**2 * group.mass)
            group = replace(group, mass_damping=group.mass_damping + 2.0 * rate)
        groups[name] = group
    clean = bench.case.clean
    slow = updyn.response(
        Model.from_groups(groups, bench.case.true.dofs),
        clean.freq,
        clean.responses,
        clean.references,
        "receptance",
    )
    s = 2j * np.pi * clean.freq + rate
    values = slow.values * (s ** QUANTITIES[clean.quantity])[:, None, None]
    ratio = np.where(
        clean.values != 0, values / np.where(clean.values != 0, clean.values, 1.0), 1.0
    )
    faulty = replace(frf, values=frf.values * ratio)
    return Seeded(faulty, frf, "window-damping", decay=float(rate))


def mass_loading(bench, frf, rng):
    """A roving sensor, of 2 to 10 % of the mass that one sees at the highest line."""
    clean = bench.case.clean
    if any(d.direction.startswith("R") for d in clean.responses):
        return None
    own = updyn.response(
        bench.case.true, clean.freq, clean.responses, clean.responses, "accelerance"
    )
    apparent = -np.diagonal(own.values, axis1=1, axis2=2)
    mass = rng.uniform(0.02, 0.1) / np.median(np.abs(apparent[-1]))
    factor = 1.0 / (1.0 - mass * apparent)[:, :, None]
    return Seeded(replace(frf, values=frf.values * factor), frf, "mass-loading")


def mains(bench, frf, rng):
    """Hum of 0.3 to 1 times the typical level, of another phase in each channel."""
    spacing = np.gradient(frf.freq)
    for base in rng.permutation([50.0, 60.0]):
        away = np.abs(frf.freq - np.round(frf.freq / base) * base) / spacing
        hit = (np.round(frf.freq / base) >= 1) & (away < 0.4) & (spacing < base / 10)
        if hit.any():
            values = frf.values.copy()
            phase = np.exp(2j * np.pi * rng.uniform(size=values[hit].shape))
            level = np.median(np.sqrt(np.mean(np.abs(values) ** 2, axis=(1, 2))))
            values[hit] += rng.uniform(0.3, 1.0) * level * phase
            return Seeded(replace(frf, values=values), frf, "mains")
    return None


def common_dofs(frf: FRF) -> list[tuple[int, int, str]]:
    """Positions and labels of the DOFs that have a sensor and a force."""
    forces = plain(frf.references)
    return [(i, forces.index(d), d) for i, d in enumerate(plain(frf.responses)) if d in forces]


def answers(frf: FRF) -> np.ndarray:
    """Which channels answer, shape (n_i, n_j): of those that symmetry forbids rounding is left."""
    level = np.abs(frf.values).max(axis=0)
    return level > ROUNDING * level.max()


def one_run(frf: FRF, i: int, j: int, rng) -> FRF:
    """One FRF by itself wrong: its sign, a factor of 1.5 to 3, or late by 0.1 to 0.5 periods."""
    wrong = {
        "sign": -1.0,
        "factor": np.exp(rng.choice([-1, 1]) * rng.uniform(0.4, 1.1)),
        "delay": np.exp(-2j * np.pi * frf.freq / frf.freq[-1] * rng.uniform(0.1, 0.5)),
    }
    values = frf.values.copy()
    values[:, i, j] *= wrong[str(rng.choice(list(wrong)))]
    return replace(frf, values=values)


def reciprocity(bench, frf, rng):
    """One of the two FRFs between two places is wrong."""
    both = common_dofs(frf)
    if len(both) < 2:
        return None
    a, b = rng.choice(len(both), 2, replace=False)
    if not answers(bench.case.clean)[both[a][0], both[b][1]]:
        return None
    bad = one_run(frf, both[a][0], both[b][1], rng)
    names = [one[2] for one in both if one in (both[a], both[b])]
    ordered = [label for label in plain(frf.references) if label in names]
    return Seeded(bad, frf, "reciprocity", tuple(ordered))


def drive_point(bench, frf, rng):
    """The FRF of one drive point alone has the wrong sign, or is late by 0.2 to 0.5 periods."""
    both = common_dofs(frf)
    if not both:
        return None
    i, j, label = both[int(rng.integers(len(both)))]
    others = answers(bench.case.clean)
    others[i, j] = False
    if not (others[i].any() and others[:, j].any()):  # it is all of a sensor, or of a force
        return None
    late = np.exp(-2j * np.pi * frf.freq / frf.freq[-1] * rng.uniform(0.2, 0.5))
    values = frf.values.copy()
    values[:, i, j] *= -1.0 if rng.integers(2) else late
    return Seeded(replace(frf, values=values), frf, "drive-point", (label,))


def leakage(bench, frf, rng):
    """Impulse responses end after 0.3 to 0.7 of 1 over the spacing; they are those to 2 f_max."""
    clean = bench.case.clean
    spacing = np.diff(clean.freq)
    if np.ptp(spacing) > 1e-6 * spacing[0] or len(clean.freq) < 48:
        return None
    end, step = rng.uniform(0.3, 0.7) / spacing[0], spacing[0] / 16
    grid = np.maximum(np.arange(int(2 * clean.freq[-1] / step)) * step, 1e-3 * step)
    where = (clean.responses, clean.references, clean.quantity)
    h = np.fft.ifft(updyn.response(bench.case.true, grid, *where).values, axis=0)
    t = np.arange(len(grid)) / (len(grid) * step)
    back = np.exp(-2j * np.pi * clean.freq[:, None] * t[t < end])
    cut = replace(clean, values=np.tensordot(back, h[t < end], axes=(1, 0)))
    return Seeded(NOISE.added(cut, rng), frf, "leakage")


def scaled_groups(bench, rng, low, high):
    """The true structure with all stiffnesses changed by about one factor, each by 3 % besides."""
    factor = 1.0 + rng.choice([-1, 1]) * rng.uniform(low, high)
    stiff = [name for name, g in bench.case.true.groups.items() if g.stiffness is not None]
    return bench.case.true.scaled(
        {name: {"stiffness": factor * (1.0 + rng.uniform(-0.03, 0.03))} for name in stiff}
    )


def other_test(bench, frf, rng):
    """One response of another state: stiffnesses off by 6 to 20 %, about the same everywhere."""
    if frf.values.shape[1] < 2:
        return None
    clean = bench.case.clean
    other = updyn.response(
        scaled_groups(bench, rng, 0.06, 0.2),
        clean.freq,
        clean.responses,
        clean.references,
        clean.quantity,
    )
    i, label = sensor(frf, rng)
    values = frf.values.copy()
    values[:, i] = NOISE.added(other, rng).values[:, i]
    return Seeded(replace(frf, values=values), frf, "other-test", (label,))


def missing_mode(bench, frf, rng):
    """One more mode within the band, loss factor 0.5 to 3 %, as high as the rms of the data."""
    f = frf.freq
    f0 = np.exp(rng.uniform(np.log(f[len(f) // 5]), np.log(f[-len(f) // 5])))
    loss = rng.uniform(0.005, 0.03)
    shape = rng.uniform(0.3, 1.0, frf.values.shape[1]) * rng.choice([-1, 1], frf.values.shape[1])
    own = rng.uniform(0.3, 1.0, frf.values.shape[2])
    rows = plain(frf.responses)
    for j, label in enumerate(plain(frf.references)):
        if label in rows:
            own[j] = shape[rows.index(label)]
    power = QUANTITIES[frf.quantity]
    pole = (1j * f / f0) ** power / (1.0 + 1j * loss - (f / f0) ** 2)
    level = np.sqrt(np.mean(np.abs(frf.values) ** 2)) * rng.uniform(0.5, 1.5) * loss
    sign = (-1.0) ** (power // 2)  # the accelerance of a drive point has a positive imaginary part
    term = sign * level * pole[:, None, None] * np.outer(shape, own) * (1j ** (power % 2 * -1))
    return Seeded(replace(frf, values=frf.values + term), frf, "missing-mode")


def with_springs(model: Model, name: str, at: list[str], stiffness: float) -> Model:
    """Return a model with springs to the ground."""
    K = np.zeros((model.n_dofs, model.n_dofs))
    for label in at:
        i = plain(model.dofs).index(label)
        K[i, i] = stiffness
    return Model.from_groups({**model.groups, name: Group(K, loss_factor=0.02)}, model.dofs)


def translations(frf: FRF) -> list[str]:
    return [label for label in plain(frf.responses) if "R" not in label]


def freed(model: Model) -> Model:
    """Return a chain of masses and springs without its springs to the ground."""
    groups = {}
    for name, group in model.groups.items():
        K = group.stiffness
        if K is not None:
            K = K.toarray()
            group = replace(group, stiffness=K - np.diag(K.sum(axis=1)))
        groups[name] = group
    return Model.from_groups(groups, model.dofs)


def support(bench, frf, rng):
    """The chain on two springs, suspended at 1 to 4 times the lowest line; the model is free."""
    if bench.case.name != "chain":
        return None
    true = freed(bench.case.true)
    mass = sum(float(g.mass.sum()) for g in true.groups.values() if g.mass is not None)
    stiffness = 0.5 * mass * (2 * np.pi * frf.freq[0] * rng.uniform(1.0, 4.0)) ** 2
    at = [str(d) for d in rng.choice(plain(true.dofs), 2, replace=False)]
    clean = bench.case.clean
    where = (clean.freq, clean.responses, clean.references, clean.quantity)
    held = updyn.response(with_springs(true, "springs", at, stiffness), *where)
    sound = NOISE.added(updyn.response(true, *where), rng)
    return Seeded(NOISE.added(held, rng), sound, "support", (), freed)


def no_support(bench, frf, rng):
    """The model has a spring to the ground that is not there, as stiff as half of its DOF."""
    labels = translations(frf)
    if not labels:
        return None
    label = str(rng.choice(labels))
    i = plain(bench.case.true.dofs).index(label)
    stiffness = 0.5 * float(bench.case.true.stiffness[i, i])

    def changed(model: Model) -> Model:
        return with_springs(model, "stand", [label], stiffness)

    return Seeded(frf, frf, "no-support", ("stand",), changed)


def wrong_axes(bench, frf, rng):
    """The model has the section axes of a group, or of all, the other way round."""
    if bench.turned is None:
        return None
    right = bench.model if isinstance(bench, Measured) else bench.case.true
    names = [name for name, group in right.groups.items() if group.exchanged is not None]
    choices = [(name,) for name in names] + [tuple(names)] * (len(names) > 1)
    groups = choices[int(rng.integers(len(choices)))]

    def changed(model: Model) -> Model:
        """Return the start with these axes, as far off in stiffness and mass as it is."""
        wrong, turned = bench.turned(groups), {}
        for name in groups:
            off = {
                quantity: structures.size(model.group(name), quantity)
                / structures.size(right.group(name), quantity)
                for quantity in ("stiffness", "mass")
            }
            off["loss_factor"] = model.group(name).loss_factor
            turned[name] = wrong.group(name).changed(off)
        return replace(model, groups={**model.groups, **turned})

    return Seeded(frf, frf, "wrong-axes", groups, changed)


def none(bench, frf, rng):
    return Seeded(frf, frf, "")


def held_off(bench, frf, rng):
    """Nothing is wrong with the data; each mass, which is held, is off by 3 to 5 %."""

    def changed(model: Model) -> Model:
        off = {
            name: {"mass": 1.0 + rng.choice([-1, 1]) * rng.uniform(0.03, 0.05)}
            for name, group in model.groups.items()
            if group.mass is not None
        }
        return model.scaled(off)

    return Seeded(frf, frf, "", changed=changed)


def held_losses(bench, frf, rng):
    """Nothing is wrong with the data; no loss factor is sought, each is true, half, 0.02 or 0."""
    losses = {
        name: float(rng.choice([group.loss_factor, group.loss_factor / 2, 0.02, 0.0]))
        for name, group in bench.case.true.groups.items()
        if group.stiffness is not None
    }

    def changed(model: Model) -> Model:
        return model.scaled({name: {"loss_factor": loss} for name, loss in losses.items()})

    return Seeded(frf, frf, "", changed=changed)


def missing_element(bench, frf, rng, cause):
    """The structure has an element that the model lacks, at a place that unknowns do not imitate.

    Its dynamic stiffness is 0.1 to 0.4 of that of the structure there, the median over the lines.
    """
    evidence = at_truth(bench, frf)
    places = list(cause.list_places(evidence.part))
    for i in rng.permutation(len(places)):
        labels, between = places[i]
        element = AddedElement(cause.quantity, labels, between, 1.0, cause.loss)
        R = evidence.receptances
        stiffness = element.unit_stiffness(R.s)
        (flexibility,) = ElementVectors(R, [element]).list_flexibilities(stiffness)
        size = rng.uniform(0.1, 0.4) / flexibility
        sized = replace(element, value=size)
        if is_imitated(evidence, size * evidence.receptances.slope(replace(element, value=0.0))):
            continue
        faulty = measured_on(bench, with_element(bench.case.true, sized), rng)
        fault = cause(element.labels, size, element.between, n_places=len(places))
        return Seeded(faulty, frf, cause.kind, element.labels, fault=fault)
    return None


def at_truth(bench, frf) -> Evidence:
    """Model and data at the true unknowns, what is held of the model being loose, too."""
    data = with_variance(bench.case.clean, choose_noise(None, frf))
    part = free_held_quantities(
        FRFPart.build(bench.case.true, data, bench.sought(bench.case.true))
    )[0]
    return Evidence(part, part.coordinates.start)


def is_imitated(evidence: Evidence, change: np.ndarray, least: float = SEEN_CHANGE) -> bool:
    """Whether the unknowns and held values do the same to first order, but for noise."""
    b = np.append(stack_real_imag(evidence.weight * change), np.zeros(evidence.part.n))
    b[: -evidence.part.n] /= NOISE.relative
    n = len(b) - evidence.part.n
    A = np.vstack([evidence.jacobian / NOISE.relative, np.diag(1.0 / evidence.spread)])
    Q = np.linalg.qr(A)[0]
    left = b - Q @ (Q.T @ b)
    return bool(2.0 * left @ left / n < least**2)


def with_element(model: Model, element: AddedElement) -> Model:
    """Return a model with an element; a mass acts in all translations of its node."""
    labels = list(element.labels)
    if element.quantity == "mass" and "R" not in labels[0]:
        node = labels[0].partition(":")[0]
        labels = [one for one in plain(model.dofs) if one.startswith(f"{node}:") and "R" not in one]
        element = replace(element, labels=tuple(labels))
    at = [plain(model.dofs).index(label) for label in labels]
    u = np.zeros((model.n_dofs, len(at)))
    u[at, np.arange(len(at))] = 1.0
    u = u @ element.incidence
    matrix = {element.quantity: element.value * (u @ u.T)}
    return Model.from_groups(
        {**model.groups, "lacking": Group(loss_factor=element.loss, **matrix)}, model.dofs
    )


def measured_on(bench, true: Model, rng) -> FRF:
    clean = bench.case.clean
    where = (clean.freq, clean.responses, clean.references, clean.quantity)
    return NOISE.added(updyn.response(true, *where), rng)


def missing_spring(bench, frf, rng):
    return missing_element(bench, frf, rng, MissingSpring)


def missing_mass(bench, frf, rng):
    return missing_element(bench, frf, rng, MissingMass)


def missing_dashpot(bench, frf, rng):
    return missing_element(bench, frf, rng, MissingViscous)


def missing_proportional(bench, frf, rng):
    """Viscous damping of a group or of all, a loss factor of 0.02 to 0.1 amid the band."""
    evidence = at_truth(bench, frf)
    part, omega = evidence.part, 2 * np.pi * np.median(frf.freq)
    for name in rng.permutation(list_fixed_coefficients(part)):
        loss = rng.uniform(0.02, 0.1)
        rates = RayleighIncrement.from_name(
            str(name), loss * omega if "mass" in name else loss / omega
        )
        if is_imitated(evidence, rates.value * evidence.slopes_by_rate[str(name)]):
            continue
        true = bench.case.true
        more = {
            group: {rates.quantity: getattr(true.group(group), rates.quantity) + rates.value}
            for group in rates.list_groups(part.solver.system)
        }
        faulty = measured_on(bench, true.with_damping(more), rng)
        fault = ProportionalDamping((str(name),), rates.value)
        return Seeded(faulty, frf, fault.kind, fault.channels, fault=fault)
    return None


def loss_with_frequency(bench, frf, rng):
    """The loss factor of a group, 0.02 to 0.1 amid the band, rises or falls by a factor of 2 to 4.

    It follows a power of the frequency, and so does the storage modulus in every second draw.
    """
    causes = [one for one in LossOverFrequency.propose_faults(at_truth(bench, frf)) if one.groups]
    for i in rng.permutation(len(causes)):
        course = rng.choice([-1, 1]) * rng.uniform(np.log(2), np.log(4))
        cause = replace(causes[i], value=course / np.log(causes[i].lines[-1] / causes[i].lines[0]))
        loss = {name: {"loss_factor": rng.uniform(0.02, 0.1)} for name in cause.groups}
        lossy = replace(bench.case, true=bench.case.true.with_damping(loss))
        there = at_truth(replace(bench, case=lossy), frf)
        if is_imitated(
            there, compute_log_ratio(there.part, cause.alteration, there.x), SPREAD_CHANGE
        ):
            continue
        values = AlteredPart.of(there.part, cause.alteration).responses(there.x)
        faulty = NOISE.added(replace(bench.case.clean, values=values), rng)
        return Seeded(faulty, frf, cause.kind, cause.channels, fault=cause)
    return None


FAULTS: dict[str, Callable[..., Seeded | None]] = {
    "none": none,
    "quantity": quantity,
    "unit": unit,
    "sign": sign,
    "swapped": swapped,
    "moved": moved,
    "calibration": calibration,
    "common calibration": common,
    "delay": delay,
    "frequency scale": frequency_scale,
    "low-pass": low_pass,
    "conjugated": conjugated,
    "window": window,
    "mass loading": mass_loading,
    "mains": mains,
    "reciprocity": reciprocity,
    "drive point": drive_point,
    "leakage": leakage,
    "other test": other_test,
    "missing mode": missing_mode,
    "support": support,
    "no support": no_support,
    "held off": held_off,
    "held losses": held_losses,
    "quantity of one": quantity_of_one,
    "turned": turned,
    "missing dashpot": missing_dashpot,
    "missing proportional damping": missing_proportional,
    "missing spring": missing_spring,
    "missing mass": missing_mass,
    "force moved": force_moved,
    "wrong axes": wrong_axes,
    "loss with frequency": loss_with_frequency,
}
#: Those whose data are computed from the true structure, which is not known of a measured one.
COMPUTED = (
    "moved",
    "force moved",
    "window",
    "mass loading",
    "reciprocity",
    "drive point",
    "leakage",
    "other test",
    "support",
    "no support",
    "held losses",
    "missing dashpot",
    "missing proportional damping",
    "missing spring",
    "missing mass",
    "loss with frequency",
)
#: What all unknowns together can imitate, unless masses are known.
IMITATED = ("unit", "common calibration", "frequency scale", "held off")


def unknowns(
    bench: structures.Bench | Measured, model: Model, fault: str, *, free: bool
) -> ParameterSet:
    sought = bench.sought(model)
    if fault == "held losses":
        return ParameterSet(tuple(p for p in sought if p.quantity != "loss_factor"))
    if free or fault not in IMITATED:
        return sought
    known = (
        [p for p in sought if p.quantity == "stiffness"][:1] if fault == "frequency scale" else []
    )
    return ParameterSet(tuple(p for p in sought if p.quantity != "mass" and p not in known))


def names(found, seeded: Seeded) -> bool:
    """Whether the first finding is the fault that was seeded, or undoes it."""
    if not found:
        return False
    first = found[0]
    channels = first.channels
    if first.kind == "swapped":
        channels = tuple(sorted(channels))
    if (first.kind, channels) == (seeded.kind, seeded.channels):
        return True
    if any(
        other.partition("=")[0] == ":".join(filter(None, [seeded.kind, ",".join(seeded.channels)]))
        for other in first.also
    ):
        return True  # told as one that these data do not tell from the first
    if seeded.kind == "support" and first.statement.startswith("The structure seems to be supp"):
        return True  # one spring to the ground acts as the two that were seeded
    return first.kind == seeded.kind and undone(first, seeded)


def beside_known(bench, seeded: Seeded, found):
    """Return the findings but for what is known to be wrong in any case."""
    known = bench.known if isinstance(bench, Measured) and seeded.kind not in bench.known else ()
    return [one for one in found if one.kind not in known]


def undone(finding, seeded: Seeded) -> bool:
    """Whether the repaired data are those without the fault, but for 3 %."""
    try:
        repaired = finding.repair(seeded.faulty)
    except updyn.UpdynError:
        return False
    if (
        repaired.values.shape != seeded.sound.values.shape
        or repaired.responses != seeded.sound.responses
    ):
        return False
    off = np.abs(repaired.values - seeded.sound.values) / np.abs(seeded.sound.values)
    return bool(np.median(off) < 0.03 and np.allclose(repaired.freq, seeded.sound.freq, rtol=3e-3))


@cache
def bounds(name: str, fault: str, quantity: str, free: bool, decay: float = 0.0) -> np.ndarray:
    bench = bench_of(name)
    if isinstance(bench, Measured):
        return bench.bound(unknowns(bench, bench.model, fault, free=free))
    case = replace(bench.case, clean=bench.case.clean.converted(quantity))
    own = replace(bench, case=case, sought=lambda model: unknowns(bench, model, fault, free=free))
    return windowed_bound(own, decay) if decay else own.bound(NOISE)


def windowed_bound(bench: structures.Bench, decay: float) -> np.ndarray:
    """Return the bounds of data through a window whose decay is unknown, too."""
    clean, true = bench.case.clean, bench.case.true
    where = (clean.freq, clean.responses, clean.references, clean.quantity)

    def part(rate: float) -> FRFPart:
        return FRFPart.build(true, updyn.response(true, *where, decay=rate), bench.sought(true))

    here, step = part(decay), 1e-4 * decay
    x = here.coordinates.start
    block = here.block(x, slice(None))
    by_decay = (part(decay + step).responses(x) - part(decay - step).responses(x)) / (2.0 * step)
    std = np.sqrt(NOISE.variance(here.frf)) / np.sqrt(2.0)
    J = np.concatenate([block.dH, by_decay[None]]).reshape(here.n + 1, -1) / std.ravel()
    R = np.linalg.qr(np.concatenate([J.real, J.imag], axis=1).T)[1]
    return np.linalg.norm(np.linalg.solve(R.T, np.eye(len(R))), axis=0)[:-1]


def recovers(task: Draw, start: Model, frf: FRF, sought: ParameterSet, decay: float = 0.0) -> bool:
    bench = bench_of(task.structure)
    result = updyn.update(start, frf, sought)
    off = [
        abs(result.values[p.name] - bench.truth(p, start))
        / (1.0 if p.quantity == "loss_factor" else abs(bench.truth(p, start)))
        for p in sought
    ]
    bound = np.maximum(
        *(bounds(task.structure, task.fault, frf.quantity, task.free, a) for a in (0.0, decay))
    )
    return bool((np.array(off) <= 4.0 * bound).all())


@dataclass(frozen=True)
class Draw:
    """One seeded fault; `fits` are made but for a look before any fit.

    `faulty`: one of them is to the data as they are; the others judge the repair. `strict`: by the
    bounds of data without a window.
    """

    structure: str
    fault: str
    seed: int
    free: bool
    fits: bool
    faulty: bool = True
    strict: bool = False


def drawn(task: Draw) -> dict[str, object] | None:
    """What is said of a draw; None where the structure cannot have the fault."""
    os.environ["OMP_NUM_THREADS"] = "1"
    warnings.simplefilter("ignore")
    case = seeded_case(task)
    if case is None:
        return None
    bench, start, sought, seeded = case
    begun = time.perf_counter()
    found = beside_known(bench, seeded, updyn.diagnose(start, seeded.faulty, sought))
    out: dict[str, object] = {
        "seconds": time.perf_counter() - begun,
        "before": names(found, seeded),
        "false": len(found) - names(found, seeded),
        "said": [f.written or f.kind for f in found],
    }
    if not task.fits:
        return out
    if task.faulty:
        begun = time.process_time()
        result = updyn.update(start, seeded.faulty, sought)
        out["fit_s"] = time.process_time() - begun
        out["after"] = names(beside_known(bench, seeded, result.findings), seeded)
        out["status"] = result.status
    repairable = out["before"] and seeded.kind and found[0].written
    if repairable and recovers(task, start, seeded.sound, sought):
        decay = 0.0 if task.strict else seeded.decay
        out["repaired"] = recovers(task, start, found[0].repair(seeded.faulty), sought, decay)
    return out


def seeded_case(task: Draw) -> tuple[Bench, Model, ParameterSet, Seeded] | None:
    """Return bench, start, unknowns and data; None where the structure cannot have the fault."""
    name, fault = task.structure, task.fault
    bench = bench_of(name)
    if isinstance(bench, Measured) and fault in COMPUTED:
        return None
    rng = np.random.default_rng([task.seed, list(FAULTS).index(fault)])
    start = bench.start(rng, OFF)
    start = with_known(bench, start, unknowns(bench, start, fault, free=task.free))
    frf = bench.frf if isinstance(bench, Measured) else NOISE.added(bench.case.clean, rng)
    seeded = FAULTS[fault](bench, frf, rng)
    if seeded is None:
        return None
    return bench, seeded.changed(start), unknowns(bench, start, fault, free=task.free), seeded


def with_known(bench, start: Model, sought: ParameterSet) -> Model:
    """Return the start with the true values of what is not sought."""
    known: dict[str, dict[str, float]] = {}
    for p in bench.sought(start):
        if p.name not in sought.names:
            known.setdefault(p.group, {})[p.quantity] = bench.truth(p, start)
    return start.scaled(known) if known else start


def odds(task: Draw) -> float | None:
    """Logarithm (base 10) of the odds of the fault that was seeded; None where it cannot be."""
    warnings.simplefilter("ignore")
    case = seeded_case(task)
    if case is None:
        return None
    bench, start, sought, seeded = case
    noise = choose_noise(None, seeded.faulty)
    data = with_variance(seeded.faulty, noise)
    whole = FRFPart.build(start, data, sought).thin(LINES)
    truth = whole.coordinates.to_x(np.array([bench.truth(p, start) for p in sought]))
    part, held = free_held_quantities(whole)
    stage, x = choose_trial_models(part), np.concatenate([truth, held])
    here = stage.prepare_part(part, [x])
    fault = seeded.fault or replace(CAUSES[seeded.kind](seeded.channels), value=seeded.value)
    without = run_trial(here, None, [raise_loss_factors(here, here.coordinates.start), x])
    if without is not None and has_small_residual(without):
        here = weight_by_noise(here, without, noise)
        without = run_trial(here, None, [without.x, x])
    trial = run_trial(here, fault, [x])
    if without is None or trial is None:
        return None
    return float((trial.gain(without) + np.log(fault.prior)) / np.log(10.0))


def told_odds(name: str, fault: str, seeds: Iterable[int], *, free: bool) -> str:
    """A line with the odds of what is missed and of what is found, medians."""
    by_name: dict[bool, list[float]] = {True: [], False: []}
    for seed in seeds:
        task = Draw(name, fault, seed, free, fits=False)
        found, log_odds = drawn(task), odds(task)
        if found is not None and log_odds is not None:
            by_name[bool(found["before"])].append(log_odds)
    columns = [
        f"{len(there)} | {np.median(there):.1f} | {sum(one < FOUND for one in there)}"
        if there
        else "0 | - | 0"
        for there in (by_name[True], by_name[False])
    ]
    return f"| {name} | {fault} | {' | '.join(columns)} |"


def row(name: str, fault: str, draws: list[dict[str, object]]) -> str:
    columns = []
    for key in ("before", "after", "repaired"):
        there = [one[key] for one in draws if key in one]
        columns.append(f"{sum(map(bool, there))} of {len(there)}" if there else "-")
    doubted = sum(one.get("status") == "not-credible" for one in draws)
    false = sum(int(one["false"]) for one in draws)
    seconds = np.median([one["seconds"] for one in draws])
    fits = [one["fit_s"] for one in draws if "fit_s" in one]
    columns += [
        f"{false}",
        f"{doubted}",
        f"{seconds:.2f}",
        f"{np.median(fits):.1f}" if fits else "-",
    ]
    return f"| {name} | {fault} | {' | '.join(columns)} |"


def main() -> None:
    given = arguments()
    if given.odds:
        print(
            "| structure | fault | found | log10 odds, median | below 2 | missed | log10 odds,"
            " median | below 2 |\n|---|---|---|---|---|---|---|---|"
        )
        for name in given.structures.split(","):
            for fault in given.faults.split(","):
                seeds = range(given.seed, given.seed + given.draws)
                print(told_odds(name, fault, seeds, free=given.free), flush=True)
        return
    kept = Kept(given.out, drawn)
    print(
        "| structure | fault | before | after | repaired | other findings | not credible | s |"
        " fit, s |\n|---|---|---|---|---|---|---|---|---|"
    )
    for name in given.structures.split(","):
        for fault in given.faults.split(","):
            seeds = range(given.seed, given.seed + given.draws)
            how = (given.free, not given.before_only, not given.repairs_only, given.strict)
            tasks = [Draw(name, fault, seed, *how) for seed in seeds]
            kept.make(tasks, given.workers)
            draws = [kept[task] for task in tasks if kept[task] is not None]
            if not draws:
                continue
            print(row(name, fault, draws), flush=True)
            if given.verbose:
                for one in draws:
                    print("   ", one, flush=True)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--structures", default="chain,gear train,building,space frame,beam")
    parser.add_argument("--faults", default=",".join(FAULTS))
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--free", action="store_true", help="masses are unknown in any case")
    parser.add_argument("--strict", action="store_true", help="bounds of data without a window")
    fits = parser.add_mutually_exclusive_group()
    fits.add_argument("--before-only", action="store_true")
    fits.add_argument("--repairs-only", action="store_true")
    fits.add_argument("--odds", action="store_true", help="of the seeded fault against none")
    parser.add_argument("--out", type=Path, help="file that keeps the draws")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--verbose", action="store_true")
    return parser.parse_args()


if __name__ == "__main__":
    from faults import main  # under its own name, where processes find what they are sent

    main()
