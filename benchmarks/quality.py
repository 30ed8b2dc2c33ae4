"""Quality of records: how often seeded faults are found, and how often sound records are blamed.

Hammer records of structures drawn at random: four modes between 25 and 450 Hz (loss factor 1 % or
more, so that all is quiet after 4 s), two accelerometers, five hits of other levels, beside the
point by a little (modal constants scatter by 3 %), 4096 samples a second, a quarter of a second
before the hit. Noise on every channel, white and 1/f, 0.01 to 0.2 % of its largest value;
converters of 24 bits, whose filters ring ahead of the hit. A fault is put into one hit or into all,
as it occurs.

    python benchmarks/quality.py [--draws 20] [--sound 200] [--seed 0]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin, lfilter

from updyn.signals.quality import RecordFinding, check_records, hits
from updyn.signals.records import Records

RATE, N, BEFORE, HITS = 4096, 16384, 1024, 5
BAND = (20.0, 500.0)
NAMES, UNITS = ("hammer", "1:Z", "2:Z"), ("N", "m/s^2", "m/s^2")

Rng = np.random.Generator
Real = NDArray[np.float64]


@dataclass(frozen=True)
class Structure:
    """Modes that accelerometers see, and where the hammer hits."""

    frequency: Real
    damping: Real
    constants: Real  # (2, modes)

    @classmethod
    def drawn(cls, rng: Rng) -> Structure:
        frequency = np.sort(np.exp(rng.uniform(np.log(25.0), np.log(450.0), 4)))
        while np.min(frequency[1:] / frequency[:-1]) < 1.15:
            frequency = np.sort(np.exp(rng.uniform(np.log(25.0), np.log(450.0), 4)))
        sign = rng.choice([-1.0, 1.0], (2, 4))
        constants = sign * rng.uniform(0.2, 1.0, (2, 4))
        # Low modes decay within the record.
        damping = np.maximum(rng.uniform(0.005, 0.02, 4), 0.4 / frequency)
        return cls(frequency, damping, constants)

    def response(self, force: Real, scatter: Real, cubic: float = 0.0) -> Real:
        """Accelerations, shape (2, n): each mode is carried on exactly between samples."""
        out = np.zeros((2, len(force)))
        for f, zeta, constants, one in zip(
            self.frequency, self.damping, self.constants.T, scatter.T, strict=True
        ):
            omega = 2.0 * np.pi * f
            if cubic and f == self.frequency[0]:
                motion = duffing(force, omega, zeta, cubic)
            else:
                motion = mode(force, omega, zeta)
            out += (constants * one)[:, None] * motion
        return out


def mode(force: Real, omega: float, zeta: float) -> Real:
    """Acceleration of a mode of unit mass: Craig and Kurdila (2006), section 6.2."""
    pole = omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))
    grown = np.exp(pole / RATE)
    held = (grown - 1.0) / pole
    rising = (grown - 1.0 - pole / RATE) / (pole**2 / RATE)
    q = lfilter([rising, held - rising], [1.0, -grown], force)
    # x = Im q / Im pole; its second derivative by the equation of motion.
    x, v = q.imag / pole.imag, (pole * q).imag / pole.imag
    return np.asarray(force - 2.0 * zeta * omega * v - omega**2 * x)


def duffing(force: Real, omega: float, zeta: float, cubic: float, fine: int = 4) -> Real:
    """Acceleration of a mode whose stiffness grows by a share at 1 mm: semi-implicit Euler."""
    step = 1.0 / (RATE * fine)
    x = v = 0.0
    out = np.empty(len(force))
    at = np.interp(np.arange(len(force) * fine) / fine, np.arange(len(force)), force).tolist()
    k, c, k3 = omega**2, 2.0 * zeta * omega, cubic * omega**2 / 1e-6
    for i, load in enumerate(at):
        a = load - c * v - k * x - k3 * x * x * x
        if i % fine == 0:
            out[i // fine] = a
        v += step * a
        x += step * v
    return out


@dataclass
class Hits:
    """A test before the converter: what faults are put into."""

    structure: Structure
    force: Real  # (hits, n)
    motion: Real  # (hits, 2, n)
    noise: float


def pulse(size: float, width: float) -> Real:
    """Half a sine, in N."""
    time_ = (np.arange(N) - BEFORE) / RATE
    inside = (time_ > 0.0) & (time_ < width)
    return np.where(inside, size * np.sin(np.pi * time_ / width), 0.0)


def drawn(rng: Rng, *, width: float | None = None, cubic: float = 0.0) -> Hits:
    """A sound test, or one of a soft tip or a structure that is not linear."""
    structure = Structure.drawn(rng)
    levels = rng.uniform(60.0, 240.0, HITS)
    levels[:2] = 60.0, 240.0
    wide = rng.uniform(1.6e-3, 1.9e-3) if width is None else width
    force = np.array([pulse(size, wide) for size in rng.permutation(levels)])
    scatter = 1.0 + 0.03 * rng.standard_normal((HITS, 2, 4))
    motion = np.array(
        [structure.response(f, s, cubic) for f, s in zip(force, scatter, strict=True)]
    )
    return Hits(structure, force, motion, float(10.0 ** rng.uniform(-4.0, -2.7)))


def coloured(rng: Rng, n: int) -> Real:
    """Noise of rms 1: white, and as much again of 1/f from 1 Hz on."""
    spectrum = rng.standard_normal(n // 2 + 1) + 1j * rng.standard_normal(n // 2 + 1)
    freq = np.fft.rfftfreq(n, 1.0 / RATE)
    pink = np.fft.irfft(spectrum / np.sqrt(np.maximum(freq, 1.0)), n)
    return rng.standard_normal(n) + pink / pink.std()


def recorded(test: Hits, rng: Rng) -> Records:
    """The test with noise, by a converter whose filter ends at 90 % of half its rate."""
    values = np.concatenate([test.force[:, None], test.motion], axis=1)
    taps = firwin(129, 0.9)
    sized = np.abs(values).max(axis=(0, 2))
    for record in values:
        for row, channel in enumerate(record):
            filtered = np.convolve(channel, taps, mode="same")
            noise = coloured(rng, N)
            record[row] = filtered + test.noise * sized[row] * noise / noise.std()
    quantum = 4.0 * sized[:, None] / 2.0**24
    return Records.of(np.round(values / quantum) * quantum, 1.0 / RATE, NAMES, UNITS)


# -- faults --------------------------------------------------------------------------------------
def clipped(rng: Rng) -> Records:
    given = recorded(drawn(rng), rng)
    values = given.values.copy()
    hit, row = rng.integers(HITS), rng.integers(3)
    limit = rng.uniform(0.4, 0.8) * np.abs(values[hit, row]).max()
    values[hit, row] = np.clip(values[hit, row], -limit, limit)
    return Records.of(values, given.step, NAMES, UNITS)


def double_hit(rng: Rng) -> Records:
    test = drawn(rng)
    hit = rng.integers(HITS)
    later = round(rng.uniform(0.01, 0.15) * RATE)
    force = test.force[hit] + rng.uniform(0.08, 0.6) * np.roll(test.force[hit], later)
    test.force[hit] = force
    test.motion[hit] = test.structure.response(force, np.ones((2, 4)))
    return recorded(test, rng)


def short_force(rng: Rng) -> Records:
    return recorded(drawn(rng, width=rng.uniform(3.5e-3, 8e-3)), rng)


def cut_off(rng: Rng) -> Records:
    given = recorded(drawn(rng), rng)
    n = BEFORE + round(rng.uniform(0.1, 0.25) * RATE)
    return Records.of(given.values[:, :, :n], given.step, NAMES, UNITS)


def leakage(rng: Rng) -> Records:
    """The structure still rings from the hit before."""
    test = drawn(rng)
    hit = rng.integers(HITS)
    structure = test.structure
    # That of the mode that rings longest, as it is some time after a hit.
    slow = int(np.argmin(structure.frequency * structure.damping))
    omega = 2.0 * np.pi * structure.frequency[slow]
    rate = omega * structure.damping[slow]
    time_ = np.arange(N) / RATE
    ringing = np.exp(-rate * time_) * np.sin(omega * time_ + rng.uniform(0.0, 6.0))
    for row in range(2):
        early = test.motion[hit, row, BEFORE : BEFORE + N // 20]
        wanted = rng.uniform(0.05, 0.3) * np.sqrt(np.mean(early**2))
        now = np.sqrt(np.mean(ringing[:BEFORE] ** 2))
        test.motion[hit, row] += wanted / now * ringing
    return recorded(test, rng)


def drift(rng: Rng) -> Records:
    given = recorded(drawn(rng), rng)
    values = given.values.copy()
    row, share = rng.integers(3), rng.uniform(0.02, 0.2)
    time_ = np.arange(N) / N
    way = time_ if rng.random() < 0.5 else (1.0 - np.exp(-4.0 * time_)) / (1.0 - np.exp(-4.0))
    for hit in range(HITS):
        values[hit, row] += rng.choice([-1.0, 1.0]) * share * np.abs(values[hit, row]).max() * way
    return Records.of(values, given.step, NAMES, UNITS)


def mains(rng: Rng) -> Records:
    given = recorded(drawn(rng), rng)
    values = given.values.copy()
    row, share = rng.integers(3), rng.uniform(0.005, 0.05)
    f = rng.choice([50.0, 60.0]) + rng.uniform(-0.05, 0.05)
    size = np.abs(values[:, row]).max()
    time_ = np.arange(N) / RATE
    for hit in range(HITS):
        for harmonic, part in ((1, 1.0), (2, 0.2), (3, 0.4)):
            phase = 2.0 * np.pi * rng.random()
            wave = np.sin(2.0 * np.pi * harmonic * f * time_ + phase)
            values[hit, row] += share * part * size * wave
    return Records.of(values, given.step, NAMES, UNITS)


def noise_floor(rng: Rng) -> Records:
    test = drawn(rng)
    test.noise = rng.uniform(0.05, 0.2)
    given = recorded(test, rng)
    # The hammer is quiet: only the accelerometers are not.
    quiet = recorded(Hits(test.structure, test.force, test.motion, 1e-3), rng)
    values = given.values.copy()
    values[:, 0] = quiet.values[:, 0]
    return Records.of(values, given.step, NAMES, UNITS)


def level_dependence(rng: Rng) -> Records:
    """A stiffness that grows with the motion of the lowest mode, by 5 to 30 % at the largest."""
    structure_seed = int(rng.integers(2**31))
    largest = (
        240.0
        * 1.1e-3
        / (2.0 * np.pi * Structure.drawn(np.random.default_rng(structure_seed)).frequency[0])
    )
    cubic = rng.uniform(0.05, 0.3) * (1e-3 / largest) ** 2
    return recorded(drawn(np.random.default_rng(structure_seed), cubic=cubic), rng)


FAULTS: dict[str, Callable[[Rng], Records]] = {
    "clipped": clipped,
    "double-hit": double_hit,
    "short-force": short_force,
    "cut-off": cut_off,
    "leakage": leakage,
    "drift": drift,
    "mains": mains,
    "noise-floor": noise_floor,
    "level-dependence": level_dependence,
}
#: What a fault brings with it, so that naming it is no false alarm.
WITH = {
    "clipped": {"level-dependence"},
    "short-force": {"noise-floor"},
    "cut-off": {"leakage"},
    "leakage": {"cut-off"},
    "noise-floor": {"cut-off"},
}


def looked_at(records: Records) -> tuple[RecordFinding, ...]:
    return check_records(records, "hammer", band=BAND)


def of_faults(draws: int, seed: int) -> None:
    """Print how often each fault is found, and what else is named."""
    named = blamed = 0
    print(f"{'fault':<18}{'found':>7}  others named")
    for number, (kind, make) in enumerate(FAULTS.items()):
        found, others = 0, []
        for draw in range(draws):
            kinds = {
                one.kind for one in looked_at(make(np.random.default_rng([seed, number, draw])))
            }
            found += kind in kinds
            others += sorted(kinds - {kind} - WITH.get(kind, set()))
        named += found
        blamed += len(others)
        text = ", ".join(f"{name} {others.count(name)}" for name in sorted(set(others)))
        print(f"{kind:<18}{found:>4}/{draws}  {text or '-'}")
    total = draws * len(FAULTS)
    print(f"found {named} of {total} ({100.0 * named / total:.1f} %); others named {blamed}")


def of_sound(sets: int, seed: int) -> None:
    """Print how many sound sets are blamed."""
    alarms: list[str] = []
    blamed = 0
    for draw in range(sets):
        rng = np.random.default_rng([seed, 99, draw])
        kinds = {one.kind for one in looked_at(recorded(drawn(rng), rng))}
        blamed += bool(kinds)
        alarms += sorted(kinds)
    text = ", ".join(f"{name} {alarms.count(name)}" for name in sorted(set(alarms)))
    share = 100.0 * blamed / sets
    print(f"sound sets of {HITS} hits blamed: {blamed} of {sets} ({share:.1f} %) {text}")


def shaken(rng: Rng, segments: float) -> tuple[Records, float]:
    """A minute of random force, and segments of so many times what the narrowest peak needs.

    A Hann window takes 10 % off a peak whose half-power bandwidth is about 3 lines wide.
    """
    structure = Structure.drawn(rng)
    n = 60 * RATE
    force = rng.standard_normal(n)
    motion = structure.response(force, np.ones((2, 4)))
    values = np.concatenate([force[None], motion])
    size = values.std(axis=1)
    noise = np.array([coloured(rng, n) for _ in range(3)])
    given = Records.of((values + 0.01 * size[:, None] * noise)[None], 1.0 / RATE, NAMES, UNITS)
    narrowest = 2.0 * float(np.min(structure.frequency * structure.damping))
    return given, segments * 3.0 / narrowest


def of_lasting(draws: int, sound: int, seed: int) -> None:
    """Print how often segments that are too short are found, and long enough ones blamed."""
    found = alarms = 0
    for draw in range(draws + sound):
        rng = np.random.default_rng([seed, 98, draw])
        given, segment = shaken(rng, 0.25 if draw < draws else 4.0)
        kinds = {one.kind for one in check_records(given, "hammer", band=BAND, segment=segment)}
        if draw < draws:
            found += "leakage" in kinds
        else:
            alarms += bool(kinds)
    print(
        f"random force: short segments found {found} of {draws}, long ones blamed {alarms} of"
        f" {sound}"
    )


def few_clipped(rng: Rng, samples: int, hits: int, bits: int) -> Records:
    """A range that so many samples of each of some hits exceed, in one channel and direction."""
    given = recorded(drawn(rng), rng)
    values = given.values.copy()
    row = int(rng.integers(3))
    sign = 1.0 if row == 0 else rng.choice([-1.0, 1.0])
    channel = sign * values[:, row]
    quantum = 4.0 * np.abs(channel).max() / 2.0**bits
    channel = np.round(channel / quantum) * quantum
    numbers = rng.permutation(HITS)[:hits]
    ordered = np.sort(channel[numbers], axis=1)
    # All these hits are as large, so that one range cuts as many samples off each.
    tops = ordered[:, -samples - 1]
    channel[numbers] *= (tops.max() / tops)[:, None]
    channel = np.round(channel / quantum) * quantum
    ordered = np.sort(channel[numbers], axis=1)
    low, high = ordered[:, -samples - 1].max(), ordered[:, -samples].min()
    limit = np.round(rng.uniform(low, high) / quantum) * quantum
    channel[numbers] = np.minimum(channel[numbers], limit)
    values[:, row] = sign * channel
    return Records.of(values, given.step, NAMES, UNITS)


def rounded(records: Records, bits: int) -> Records:
    """The records by a converter of so many bits, with four times the range that they need."""
    quantum = 4.0 * np.abs(records.values).max(axis=(0, 2))[:, None] / 2.0**bits
    return Records.of(np.round(records.values / quantum) * quantum, records.step, NAMES, UNITS)


def overloads(records: Records) -> int:
    """How many overloads are found in the channels of all hits."""
    found = 0
    for row, name in enumerate(NAMES):
        channels = records.values[:, row]
        found += len(list(hits.find_equal_peaks(channels, name)))
        for number, channel in enumerate(channels, 1):
            found += len(list(hits.find_clipped_run(channel, name, number)))
            found += len(list(hits.find_clipped_pair(channel, name, number)))
    return found


def of_few(draws: int, sound: int, seed: int) -> None:
    """Print how often overloads of one or two samples are found, and sound hits called so."""
    for bits in (24, 16):
        texts = []
        for samples, n_hits in ((2, 1), (1, 2), (1, 1)):
            found = 0
            for draw in range(draws):
                rng = np.random.default_rng([seed, 97, bits, samples, n_hits, draw])
                found += overloads(few_clipped(rng, samples, n_hits, bits)) > 0
            texts.append(f"{samples} of {n_hits} hit{'s'[: n_hits - 1]} {found} of {draws}")
        print(f"samples cut off, {bits} bits: {', '.join(texts)}")
    alarms = dict.fromkeys((24, 20, 16, 12), 0)
    for draw in range(sound):
        rng = np.random.default_rng([seed, 96, draw])
        given = recorded(drawn(rng), rng)
        for bits in alarms:
            alarms[bits] += overloads(rounded(given, bits)) > 0
    text = ", ".join(f"{bits} bits {count}" for bits, count in alarms.items())
    print(f"of {sound} sound sets called overloaded: {text}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--sound", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    begin = time.perf_counter()
    if options.draws:
        of_faults(options.draws, options.seed)
    if options.sound:
        of_sound(options.sound, options.seed)
    if options.draws and options.sound:
        of_lasting(options.draws, 50, options.seed)
        of_few(options.draws, 5 * options.sound, options.seed)
    print(f"{time.perf_counter() - begin:.0f} s")


if __name__ == "__main__":
    main()
