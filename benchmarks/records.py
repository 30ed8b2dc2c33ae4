"""FRFs of records of random force: the local rational method beside H1 with a Hann window.

Structures of five modes drawn between 30 and 400 Hz with one loss factor, three accelerometers with
noise of 0.3, 1 and 3 % of their rms, one or two shakers. A record is a part of a period five times
as long, so that it begins and ends amid the vibration and the FRF is exact. Its length is given in
decay times of the lowest mode, 1 / (pi f eta). Errors are shares of |H|, near resonances (within
1.5 half-power bandwidths) and elsewhere. H1 has segments of 1/2 to 1/32 of the record, 50 %
overlap; of these the one with the least median error counts, near and elsewhere by itself, which a
user without the truth cannot choose.

    OMP_NUM_THREADS=1 python benchmarks/records.py [--draws 8] [--seed 0] [--only length]
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import updyn
from updyn.signals.local import local_rational
from updyn.signals.records import Records
from updyn.signals.spectra import Spectra

RATE, BAND, PERIODS = 1024.0, (20.0, 450.0), 5
NOISE = np.array([0.003, 0.01, 0.03])
PARTS = (2, 4, 8, 16, 32)
#: |z|^2 of circular noise is below this in 95 of 100 cases.
COVERED = -np.log(0.05)

Rng = np.random.Generator
Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Structure:
    """Modes with a loss factor, seen by three accelerometers."""

    frequency: Real
    loss: float
    responses: Real  # (3, modes)
    forces: Real  # (shakers, modes)

    @classmethod
    def drawn(cls, rng: Rng, loss: float, shakers: int) -> Structure:
        frequency = np.sort(np.exp(rng.uniform(np.log(30.0), np.log(400.0), 5)))
        while np.min(frequency[1:] / frequency[:-1]) < 1.1:
            frequency = np.sort(np.exp(rng.uniform(np.log(30.0), np.log(400.0), 5)))
        signs = [rng.choice([-1.0, 1.0], (n, 5)) for n in (3, shakers)]
        sizes = [rng.uniform(0.2, 1.0, (n, 5)) for n in (3, shakers)]
        return cls(frequency, loss, signs[0] * sizes[0], signs[1] * sizes[1])

    @property
    def decay_time(self) -> float:
        return 1.0 / (np.pi * float(self.frequency[0]) * self.loss)

    def accelerance(self, freq: Real) -> Complex:
        omega, own = 2.0 * np.pi * freq[:, None], 2.0 * np.pi * self.frequency
        modes = -(omega**2) / (own**2 * (1.0 + 1j * self.loss) - omega**2)
        return np.einsum("fm,im,jm->fij", modes, self.responses, self.forces, optimize=True)

    def is_near(self, freq: Real) -> NDArray[np.bool_]:
        width = self.frequency * self.loss
        return np.min(np.abs(freq[:, None] - self.frequency) / width, axis=1) < 1.5


def drawn_records(
    structure: Structure, rng: Rng, times: float, n: int = 1, force_noise: float = 0.0
) -> Records:
    """Records of so many decay times of the lowest mode."""
    size = round(times * structure.decay_time * RATE)
    shakers, parts = len(structure.forces), []
    H = structure.accelerance(np.fft.rfftfreq(PERIODS * size, 1.0 / RATE))
    for _ in range(n):
        force = rng.standard_normal((shakers, PERIODS * size))
        spectrum = np.einsum("fij,jf->if", H, np.fft.rfft(force, axis=1))
        motion = np.fft.irfft(spectrum, PERIODS * size, axis=1)[:, :size]
        motion += (NOISE * motion.std(axis=1))[:, None] * rng.standard_normal(motion.shape)
        measured = force[:, :size] + force_noise * rng.standard_normal((shakers, size))
        parts.append(np.vstack([measured, motion]))
    names = [f"force {j}" for j in range(shakers)] + [f"sensor {i}" for i in range(3)]
    return Records.of(parts, 1.0 / RATE, names, ["N"] * shakers + ["m/s^2"] * 3)


def estimated(records: Records, estimator: str, parts: int = 0) -> updyn.FRF:
    """The FRF; of segments, so many a record."""
    shakers = len(records.channels) - 3
    duration = records.values.shape[2] * records.step
    return updyn.estimate_frf(
        records,
        {f"force {j}": f"{j + 1}:Z" for j in range(shakers)},
        responses={f"sensor {i}": f"{i + 11}:Z" for i in range(3)},
        estimator=estimator,
        segment=duration / parts if parts else None,
        band=BAND,
    )


@dataclass
class Errors:
    """Errors of one estimator in all draws, near resonances and elsewhere."""

    medians: list[list[float]]
    highs: list[list[float]]
    squares: list[list[Real]]

    @classmethod
    def none(cls) -> Errors:
        return cls([[], []], [[], []], [[], []])

    def add(self, frf: updyn.FRF, structure: Structure) -> None:
        exact = structure.accelerance(frf.freq)
        error, near = np.abs(frf.values - exact), structure.is_near(frf.freq)
        for place, chosen in enumerate((near, ~near)):
            if not chosen.any():
                continue
            share = error[chosen] / np.abs(exact[chosen])
            self.medians[place].append(float(np.median(share)))
            self.highs[place].append(float(np.quantile(share, 0.95)))
            if frf.variance is not None:
                self.squares[place].append((error[chosen] ** 2 / frf.variance[chosen]).ravel())

    def sizes(self, place: int) -> tuple[float, float]:
        """Median and 95th percentile, median over the draws; infinite without a line."""
        if not self.medians[place]:
            return np.inf, np.inf
        return float(np.median(self.medians[place])), float(np.median(self.highs[place]))

    def honesty(self) -> str:
        """True over stated variance, and coverage of 95 % regions, near and elsewhere."""
        texts = []
        for squares in self.squares:
            z = np.concatenate(squares)
            covered = 100.0 * np.mean(z < COVERED)
            texts.append(f"{np.mean(z):.2f} {np.median(z) / np.log(2.0):.2f}  {covered:4.1f} %")
        return "   ".join(texts)


def compared(times: float, loss: float, shakers: int, draws: int, seed: int) -> None:
    """Print a row of each estimator."""
    usual = {parts: Errors.none() for parts in PARTS}
    local = {name: Errors.none() for name in ("LRM", "H1-LRM")}
    lines = []
    for draw in range(draws):
        rng = np.random.default_rng([seed, draw])
        structure = Structure.drawn(rng, loss, shakers)
        records = drawn_records(structure, rng, times)
        duration = records.values.shape[2] / RATE
        lines.append(structure.frequency * loss * duration)
        for parts, errors in usual.items():
            try:
                errors.add(estimated(records, "H1", parts), structure)
            except updyn.UpdynError:
                continue  # segments of a line or two
        for name, errors in local.items():
            if name == "LRM" or shakers == 1:  # a record has to be there for each force
                errors.add(estimated(records, name), structure)
    low, high = np.quantile(np.concatenate(lines), [0.1, 0.9])
    head = f"{loss:5g}  {times:3g}  {shakers}  {low:4.1f}-{high:<5.1f}"
    best = [min(usual.values(), key=lambda one, at=at: one.sizes(at)[0]) for at in (0, 1)]
    print(f"{head}  H1      {_sizes([one.sizes(at) for at, one in enumerate(best)])}")
    for name, errors in local.items():
        if errors.medians[0]:
            sizes = _sizes([errors.sizes(at) for at in (0, 1)])
            print(f"{' ' * len(head)}  {name:<6}  {sizes}   {errors.honesty()}")


def _sizes(pairs: list[tuple[float, float]]) -> str:
    return "  ".join(f"{100.0 * size:7.2f}" for pair in pairs for size in pair)


def of_length(draws: int, seed: int) -> None:
    """Print errors by length of the record, number of shakers and loss factor."""
    print("errors in %: near resonances median, 95th percentile; elsewhere the same;")
    print("then true over stated variance (mean, by medians), values within 95 %: near; elsewhere")
    print("  eta   T/T0 shakers, lines in a peak (10 to 90 % of peaks)")
    for shakers in (1, 2):
        for times in (2.0, 4.0, 8.0, 16.0, 32.0):
            compared(times, 0.01, shakers, draws, seed)
    for loss in (0.002, 0.005, 0.02):
        compared(4.0, loss, 1, draws, seed)


def of_bursts(draws: int, seed: int) -> None:
    """Print errors of forces that last for a share of the record: random bursts, and a sweep.

    Structures are at rest when a record begins, and are not when it ends, three decay times later.
    The local method is taken by itself: `updyn.estimate_frf` refuses forces below 2 %.
    """
    for share in (0.01, 0.02, 0.05, 0.2, 1.0):
        errors, refused = Errors.none(), 0
        for draw in range(draws):
            rng = np.random.default_rng([seed, 6, draw])
            structure = Structure.drawn(rng, 0.01, 1)
            size = round(3.0 * structure.decay_time * RATE)
            at = np.arange(PERIODS * size) / size
            force = rng.standard_normal(PERIODS * size) * ((at >= 0.05) & (at < 0.05 + share))
            if share == 1.0:
                phase = 480.0 * 0.5 * at**2  # from 0 Hz to beyond the band
                force = np.sin(2.0 * np.pi * phase * size / RATE) * (at < 1.0)
            freq = np.fft.rfftfreq(PERIODS * size, 1.0 / RATE)
            spectrum = structure.accelerance(freq)[:, :, 0] * np.fft.rfft(force)[:, None]
            motion = np.fft.irfft(spectrum, PERIODS * size, axis=0)[:size].T
            motion += (NOISE * motion.std(axis=1))[:, None] * rng.standard_normal(motion.shape)
            try:
                errors.add(unchecked(force[:size], motion), structure)
            except updyn.UpdynError:
                refused += 1
        kind = "sweep over the record" if share == 1.0 else f"random burst of {100 * share:g} %"
        sizes = _sizes([errors.sizes(at) for at in (0, 1)])
        print(f"{kind:<22} {sizes}   {errors.honesty()}   refused {refused} of {draws}")


def unchecked(force: Real, motion: Real) -> updyn.FRF:
    """The FRF by local models of a force that may be a pulse."""
    freq = np.fft.rfftfreq(len(force), 1.0 / RATE)
    band = (freq >= BAND[0]) & (freq <= BAND[1])
    F, X = (np.fft.rfft(np.atleast_2d(one))[:, band].T[None] for one in (force, motion))
    values, variance = local_rational(Spectra.of(F, X, 1.0), freq[band], ["force"])
    labels = [f"{i}:Z" for i in range(1, 4)]
    return updyn.FRF(freq[band], values, labels, ["9:Z"], "accelerance", variance=variance)


def of_force_noise(draws: int, seed: int) -> None:
    """Print the share of H that remains where the force has noise."""
    for force_noise in (0.1, 0.3):
        found: dict[str, list[float]] = {"H1": [], "LRM": []}
        for draw in range(draws):
            rng = np.random.default_rng([seed, 7, draw])
            structure = Structure.drawn(rng, 0.02, 1)
            records = drawn_records(structure, rng, 16.0, force_noise=force_noise)
            for name, values in found.items():
                frf = estimated(records, name, 8 if name == "H1" else 0)
                share = (frf.values / structure.accelerance(frf.freq)).real
                values.append(float(np.median(share[~structure.is_near(frf.freq)])))
        texts = ", ".join(f"{name} {np.median(values):.3f}" for name, values in found.items())
        expected = 1.0 / (1.0 + force_noise**2)
        print(f"noise of {force_noise:g} on the force: |H| times {texts}; expected {expected:.3f}")


def of_speed() -> None:
    """Print seconds for 15,000 lines, over those of H1."""
    structure = Structure.drawn(rng := np.random.default_rng(0), 0.01, 1)
    times = 15000.0 / (BAND[1] - BAND[0]) / structure.decay_time
    records = drawn_records(structure, rng, times)
    seconds: dict[str, float] = {}
    for name, parts in (("H1", 8), ("LRM", 0), ("H1-LRM", 0)):
        begin = time.process_time()
        frf = estimated(records, name, parts)
        seconds[name] = time.process_time() - begin
        print(f"{name:<6} {len(frf.freq)} lines, 3 responses: {seconds[name]:.2f} s", end="")
        print(f", {seconds[name] / seconds['H1']:.0f} times H1")


# -- an update ------------------------------------------------------------------------------------
TRUE = {"root": 1.2, "middle": 0.9, "tip": 0.85}
LOSS = 0.01


def chain(factors: dict[str, float], loss: float) -> updyn.Model:
    """A chain of four masses held at one end."""
    springs: dict[str, list[tuple[int | None, int, float]]] = {
        "root": [(None, 0, 2.0e5)],
        "middle": [(0, 1, 2.0e5), (1, 2, 2.0e5)],
        "tip": [(2, 3, 1.2e5)],
    }
    groups = {"masses": updyn.Group(mass=np.diag([2.0, 1.5, 1.0, 1.2]))}
    for name, parts in springs.items():
        K = np.zeros((4, 4))
        for i, j, k in parts:
            K[j, j] += k
            if i is not None:
                K[i, i] += k
                K[i, j] -= k
                K[j, i] -= k
        groups[name] = updyn.Group(K * factors[name], loss_factor=loss)
    return updyn.Model.from_groups(groups, ["1:Z", "2:Z", "3:Z", "4:Z"])


def of_updates(draws: int, seed: int, duration: float = 10.0, rate: float = 256.0) -> None:
    """Print what an update makes of the same records by each estimator."""
    labels = ["1:Z", "3:Z", "4:Z"]
    structure, start = chain(TRUE, LOSS), chain(dict.fromkeys(TRUE, 1.0), 2.0 * LOSS)
    size = round(duration * rate)
    freq = np.fft.rfftfreq(PERIODS * size, 1.0 / rate)
    H = updyn.response(structure, freq[1:], labels, ["4:Z"], quantity="accelerance").values[:, :, 0]
    unknowns = updyn.parameters(start, stiffness=list(TRUE), loss_factor=list(TRUE))
    for name, parts in (("H1", 4), ("H1", 8), ("LRM", 0), ("H1-LRM", 0)):
        errors, scores, outcomes = [], [], []
        for draw in range(2 * draws):
            rng = np.random.default_rng([seed, 8, draw])
            force = rng.standard_normal(PERIODS * size)
            spectrum = np.vstack([np.zeros((1, 3)), H * np.fft.rfft(force)[1:, None]])
            motion = np.fft.irfft(spectrum, PERIODS * size, axis=0)[:size].T
            motion += 0.01 * motion.std(axis=1, keepdims=True) * rng.standard_normal(motion.shape)
            values = np.vstack([force[:size], motion])[None]
            records = Records.of(values, 1.0 / rate, ["force", *labels], ["N"] + ["m/s^2"] * 3)
            frf = updyn.estimate_frf(
                records,
                {"force": "4:Z"},
                estimator=name,
                segment=duration / parts if parts else None,
                band=(10.0, 110.0),
            )
            result = updyn.update(start, frf, unknowns)
            outcomes.append(result.adequacy.outcome)
            for group, factor in TRUE.items():
                wanted = (factor, LOSS)
                for kind, true in zip(("stiffness", "loss_factor"), wanted, strict=True):
                    key = f"{group}.{kind}"
                    errors.append(abs(result.values[key] / true - 1.0))
                    scores.append((result.values[key] - true) / result.std[key])
        stiff, loss = (100.0 * np.median(errors[at::2]) for at in (0, 1))
        rms = float(np.sqrt(np.mean(np.square(scores))))
        told = ", ".join(f"{outcome} {count}" for outcome, count in Counter(outcomes).items())
        kind = f"{name}, {parts} segments" if parts else name
        print(f"{kind:<16} median error {stiff:.4f} % of stiffness, {loss:.3f} % of loss factors;")
        print(f"{'':<16} error over standard deviation, rms {rms:.2f}; {told}")


SECTIONS: dict[str, Callable[[int, int], None]] = {
    "length": of_length,
    "bursts": of_bursts,
    "force-noise": of_force_noise,
    "speed": lambda draws, seed: of_speed(),
    "updates": of_updates,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--draws", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", choices=SECTIONS)
    given = parser.parse_args()
    for name, section in SECTIONS.items():
        if given.only in (None, name):
            print(f"-- {name}")
            section(given.draws, given.seed)


if __name__ == "__main__":
    main()
