"""How many modes `updyn.identify_modes` finds over a whole band, with its defaults.

Structures are sums of modes in closed form, `chosen` of them in the band and some above and below:
shapes sin(m pi x) sin(n pi y) at random points of a plate with unit mass, frequencies at random but
every fifth 0.2 % above the one before, loss factors 0.4 to 2 %; 3,200 lines up to 800 Hz. Noise is
proportional, plus a floor of a tenth of it as a share of the rms of each channel. Roving: with each
response the sensor moves, and its mass lowers the frequencies by up to 0.3 % (first order: half its
mass times the squared shape there); the frequencies looked for are the means.

A mode counts as found where one that is returned lies within 0.3 % of its frequency and 10 % of its
loss factor, one for each. The other modes returned are spurious. Coverage: true frequencies, loss
factors, and components of the shapes of unit length, within 1.96 standard deviations of those
found. Seconds are those of the processor.

Two other programs, for comparison (`--peer sdypy` or `--peer pyoma2`; each must be installed): the
least-squares complex frequency method of sdypy-EMA with a common denominator (order 100) and that
of pyOMA2 with a matrix of denominators (200 poles, stable from the order below to the highest).
Both expect the user to pick poles. Here the stable pole next to each true frequency is picked, so
spurious ones cannot be counted.

    python benchmarks/identify.py [--cases "few;few, 5 %"] [--draws 10] [--peer sdypy]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
import scipy.optimize

import updyn

BAND, LINES = (2.0, 800.0), 3200
NEAR, DAMPED = 0.003, 0.10


@dataclass(frozen=True)
class Case:
    """What is measured, and what is wrong with it."""

    modes: int
    responses: int
    references: int
    noise: float = 0.0
    offset: float = 0.0
    roving: bool = False
    pairs: bool = True
    real: Real | None = None
    lines: int = LINES


@dataclass(frozen=True)
class Real:
    """What real FRFs have.

    Attributes
    ----------
    tilt : float
        Level of the lowest modes below the highest, in dB.
    flat : float
        Flat noise over the rms of all FRFs, times 0.3 to 3 from channel to channel.
    window : float
        Decay of an exponential window on the records, in 1/s: noise that is smooth over lines.
    light : float
        Factor on all loss factors.
    weak : bool
        Whether the middle mode moves one sensor only, which is of 1 % of the sensitivity.
    mains : bool
        Whether all channels have lines of the mains.
    hits : float
        Of each hit: relative spread of gain and place; a fiftieth of it of the frequencies.
    drift : float
        Drift below 5 Hz, over the rms of each channel.
    loading : float
        Largest lowering of a frequency by the mass of what moves from reference to reference.
    turn : float
        Standard deviation of the direction of hits, in degrees: a share of another direction.
    leaning : float
        Shift of a frequency at the largest motion of its mode, in halves of its half-power
        bandwidth: cubic softening, by harmonic balance of the first order, at one level of the
        force.
    """

    tilt: float = 0.0
    flat: float = 0.0
    window: float = 0.0
    light: float = 1.0
    weak: bool = False
    mains: bool = False
    hits: float = 0.0
    drift: float = 0.0
    loading: float = 0.0
    turn: float = 0.0
    leaning: float = 0.0


CASES = {
    "few": Case(5, 8, 1),
    "few, 1 %": Case(5, 8, 1, 0.01),
    "few, 5 %": Case(5, 8, 1, 0.05),
    "two references": Case(12, 16, 2, 0.01),
    "two references, 5 %": Case(12, 16, 2, 0.05),
    "offset": Case(12, 16, 2, 0.01, offset=0.3),
    "many": Case(25, 24, 3, 0.01),
    "many, 5 %": Case(25, 24, 3, 0.05),
    "most": Case(40, 30, 3, 0.01),
    "most, 5 %": Case(40, 30, 3, 0.05),
    "hammer": Case(15, 3, 74, 0.01),
    "hammer, 5 %": Case(15, 3, 74, 0.05),
    "no pairs, one reference": Case(15, 12, 1, 0.05, pairs=False),
    "roving": Case(13, 40, 2, 0.01, roving=True, pairs=False),
    "roving, 5 %": Case(13, 40, 2, 0.05, roving=True, pairs=False),
    "low modes": Case(10, 8, 1, 0.01, pairs=False, real=Real(tilt=60.0, flat=1e-5)),
    "narrow peaks": Case(10, 8, 1, 0.01, pairs=False, real=Real(40.0, 1e-4, light=0.1)),
    "weak sensor": Case(8, 4, 1, 0.01, pairs=False, real=Real(weak=True, flat=1e-5)),
    "mains": Case(10, 8, 1, 0.01, pairs=False, real=Real(20.0, 1e-3, mains=True, drift=0.3)),
    "window": Case(10, 18, 1, 0.0, pairs=False, real=Real(flat=3e-2, window=1.0)),
    "window, tilt": Case(10, 18, 1, 0.0, pairs=False, real=Real(30.0, 1e-2, window=1.5)),
    "hits": Case(13, 3, 40, 0.01, pairs=False, real=Real(20.0, 1e-3, hits=0.05, drift=0.3)),
    "hits, window": Case(13, 3, 40, 0.0, pairs=False, real=Real(0.0, 2e-2, 1.0, hits=0.05)),
    "loading": Case(10, 6, 12, 0.01, pairs=False, real=Real(20.0, 1e-3, loading=0.003)),
    "directions": Case(10, 6, 20, 0.01, pairs=False, real=Real(20.0, 1e-3, hits=0.02, turn=5.0)),
    "leaning 0.1": Case(8, 8, 1, 0.005, pairs=False, real=Real(flat=1e-3, leaning=0.1)),
    "leaning 0.3": Case(8, 8, 1, 0.005, pairs=False, real=Real(flat=1e-3, leaning=0.3)),
    "15,000 lines": Case(12, 12, 1, 0.01, pairs=False, lines=15_000),
    "222 channels": Case(13, 3, 74, 0.01, pairs=False, lines=1_601),
    "1,000 channels": Case(25, 250, 4, 0.01, pairs=False, lines=2_000),
}


@dataclass(frozen=True, eq=False)
class Truth:
    """Modes in the band, and the measurement."""

    frequency: np.ndarray
    loss: np.ndarray
    shapes: np.ndarray  # rows: responses, then references
    frf: updyn.FRF
    by_frequency: bool = False  # a mode counts as found by its frequency alone


def drawn(case: Case, seed: int) -> Truth:
    """Return a structure and its measurement."""
    rng = np.random.default_rng([seed, case.modes, case.responses, case.references])
    natural, loss, orders = modes_of(case, rng)
    if case.real is not None:
        loss = loss * case.real.light
    inside = slice(2, 2 + case.modes)
    n = case.responses + case.references
    points = rng.uniform(0.05, 0.95, (n, 2))
    shapes = 2.0 * np.prod(np.sin(np.pi * points[:, None, :] * orders), axis=2)
    at, driven = shapes[: case.responses], shapes[case.responses :]
    freq = np.linspace(*BAND, case.lines)
    omega = 2 * np.pi * freq
    shift = np.zeros((case.responses, len(natural)))
    if case.roving:
        shift = -0.003 * at**2 / 4.0
    H = np.empty((case.lines, case.responses, case.references), complex)
    for i in range(case.responses):
        squared = (2 * np.pi * natural * (1 + shift[i])) ** 2 * (1 + 1j * loss)
        below = squared - omega[:, None] ** 2
        H[:, i] = -(omega[:, None] ** 2) * ((at[i] / below) @ driven.T)
    level = np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
    noise = rng.standard_normal((2, *H.shape)) / np.sqrt(2.0)
    floor = rng.standard_normal((2, *H.shape)) / np.sqrt(2.0)
    H = H * (1 + case.noise * (noise[0] + 1j * noise[1]))
    H += 0.1 * case.noise * level * (floor[0] + 1j * floor[1])
    H += case.offset * level * np.exp(-freq / 3.0)[:, None, None]
    if case.real is not None:
        return measured(case, case.real, rng, natural, loss, shapes)
    labels = [f"{k + 1}:Z" for k in range(n)]
    frf = updyn.FRF(
        freq, H, labels[: case.responses], labels[case.responses :], quantity="accelerance"
    )
    mean = natural * (1 + shift.mean(axis=0))
    return Truth(mean[inside], loss[inside], shapes[:, inside], frf)


def measured(case: Case, real: Real, rng, natural, loss, shapes) -> Truth:
    """Return a measurement with what real ones have; of the modes those that show.

    A mode shows that rises 10 dB above the noise of at least one channel.
    """
    at, driven = shapes[: case.responses].copy(), shapes[case.responses :]
    scale = 10.0 ** (-real.tilt / 20.0 * np.clip(1.0 - natural / 780.0, 0.0, 1.0))
    at = at * scale
    if real.weak:
        middle = 2 + case.modes // 2
        at[:, middle], at[-1] = 0.0, 0.01 * at[-1]
        at[-1, middle] = 0.01
    freq = np.linspace(*BAND, case.lines)
    omega = 2 * np.pi * freq
    H = np.empty((case.lines, case.responses, case.references), complex)
    shifts: list[np.ndarray] = []
    for j in range(case.references):
        shift, gain = 1.0 + real.hits / 50.0 * rng.standard_normal(), rng.normal(1.0, real.hits)
        place = driven[j] * (1.0 + real.hits * rng.standard_normal(len(natural)))
        if real.turn:
            angle = np.deg2rad(real.turn) * rng.standard_normal()
            place = place * np.cos(angle) + np.sin(angle) * rng.standard_normal(len(natural))
        lowered = natural * shift
        if real.loading:  # half of the mass times the squared shape, of first order
            lowered = lowered * (1.0 - real.loading * driven[j] ** 2 / 4.0)
            shifts.append(lowered)
        below = (2 * np.pi * lowered) ** 2 * (1 + 1j * loss) - omega[:, None] ** 2
        if real.leaning:
            below = leaning(below, (2 * np.pi * lowered) ** 2 * loss, real.leaning)
        H[:, :, j] = -gain * (omega[:, None] ** 2) * (place / below) @ at.T
    level = np.sqrt(np.mean(np.abs(H) ** 2, axis=0))
    size = real.flat * np.sqrt(np.mean(level**2)) * np.exp(rng.uniform(-1.2, 1.2, level.shape))
    deviation = np.hypot(size, case.noise * np.abs(H))
    rises = np.zeros(len(natural))
    for r, f in enumerate(natural):
        line = int(np.argmin(np.abs(freq - f)))
        part = np.abs(np.outer(at[:, r], driven[:, r])) * freq[line] ** 2
        part = part / np.abs(f**2 * (1 + 1j * loss[r]) - freq[line] ** 2)
        rises[r] = np.max(part / deviation[line])
    H = H * (1 + case.noise * complex_normal(rng, H.shape))
    H += size * coloured(rng, H.shape, real.window)
    H += real.drift * level * (np.exp(-freq / 1.5)[:, None, None] * complex_normal(rng, H.shape))
    if real.mains:
        for f in np.arange(50.0, 800.0, 100.0):
            H[np.argmin(np.abs(freq - f))] += level * complex_normal(rng, level.shape)
    labels = [f"{k + 1}:Z" for k in range(len(shapes))]
    responses, references = labels[: case.responses], labels[case.responses :]
    frf = updyn.FRF(freq, H, responses, references, quantity="accelerance")
    shown = np.zeros(len(natural), dtype=bool)
    shown[2 : 2 + case.modes] = rises[2 : 2 + case.modes] >= 10.0**0.5
    mean = np.mean(shifts, axis=0) if shifts else natural
    return Truth(mean[shown], loss[shown], np.vstack([at, driven])[:, shown], frf, True)


def leaning(below: np.ndarray, width: np.ndarray, shift: float) -> np.ndarray:
    """Return omega_r^2 (1 + i eta) - omega^2, lowered by the square of the motion of the mode.

    The motion q of the unit force 1 has (below - s |q|^2) q = 1; s is such that the peak is shifted
    by `shift` halves of the half-power bandwidth. Of several motions the smallest, as on a sweep
    upwards.

    Parameters
    ----------
    below : ndarray of complex, shape (lines, modes)
        Without softening.
    width : ndarray of float, shape (modes,)
        omega_r^2 eta: half of the half-power bandwidth in omega^2.
    shift : float
        In these; below 1.54 (cubic: 8 / (3 sqrt 3)) the motion is unique.
    """
    # With a = |q|^2 width^2 and x = below / width: a |x - shift a|^2 = 1, a cubic equation in a.
    x = below / width
    a = 1.0 / np.abs(x) ** 2  # far from the peak
    for index in zip(*np.nonzero(np.abs(x) < 100.0), strict=True):
        line, size = x[index].real, np.abs(x[index]) ** 2
        roots = np.roots([shift**2, -2.0 * shift * line, size, -1.0])
        a[index] = np.min(roots.real[np.abs(roots.imag) < 1e-6 * np.abs(roots)])
    return width * (x - shift * a)


def complex_normal(rng, shape: tuple[int, ...]) -> np.ndarray:
    """Return complex numbers of unit variance."""
    return rng.standard_normal((*shape, 2)) @ (1.0, 1.0j) / np.sqrt(2.0)


def coloured(rng, shape: tuple[int, ...], decay: float) -> np.ndarray:
    """Return noise of records with an exponential window of this decay (1/s), of unit variance."""
    lines = shape[0]
    step = (BAND[1] - BAND[0]) / (lines - 1)
    time = np.arange(2 * lines) / (2 * lines * step)
    envelope = np.exp(-decay * time).reshape(-1, *(1,) * (len(shape) - 1))
    record = envelope * rng.standard_normal((len(time), *shape[1:]))
    spectrum = np.fft.fft(record, axis=0)[1 : lines + 1]
    return spectrum / np.sqrt(np.mean(np.abs(spectrum) ** 2))


def modes_of(case: Case, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return frequencies, loss factors and orders (m, n): two below, those inside, above."""
    low, high = 40.0, 780.0
    gaps = rng.dirichlet(np.full(case.modes + 1, 4.0)) * (high - low)
    inside = low + np.cumsum(gaps[:-1])
    if case.pairs:
        inside[1::5] = inside[: len(inside[1::5]) * 5 : 5] * 1.002
    above = high * np.linspace(1.15, 2.5, 8)
    natural = np.concatenate([[1e-3, 1e-3], np.sort(inside), above])
    loss = rng.uniform(0.004, 0.02, len(natural))
    side = int(np.ceil(np.sqrt(len(natural)))) + 1
    pairs = np.array([(m, n) for m in range(1, side + 1) for n in range(1, side + 1)])
    by_order = pairs[np.argsort(pairs.sum(axis=1), kind="stable")][: len(natural)]
    return natural, loss, rng.permutation(by_order)


@dataclass(frozen=True)
class Score:
    """Of one draw."""

    modes: int
    found: int
    returned: int
    spurious: int
    covered: tuple[float, float, float]  # of a shape the share of its components
    asked: int
    seconds: float


def score(truth: Truth, frequency, loss, std_frequency, std_loss, within, seconds: float) -> Score:
    """Return how the modes returned compare with the true ones, paired one to one.

    `within` has the share of the components of each shape (rows) that cover those of each true one.
    """
    off = np.abs(frequency[:, None] / truth.frequency - 1.0) / NEAR
    damped = np.abs(loss[:, None] / truth.loss - 1.0) / DAMPED
    if truth.by_frequency:
        damped = np.zeros_like(off)
    good = (off <= 1.0) & (damped <= 1.0)
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(good, off + 0.1 * damped, 1e3))
    hit = good[rows, columns]
    rows, columns = rows[hit], columns[hit]
    within_f = np.abs(frequency[rows] - truth.frequency[columns]) <= 1.96 * std_frequency[rows]
    within_l = np.abs(loss[rows] - truth.loss[columns]) <= 1.96 * std_loss[rows]
    return Score(
        len(truth.frequency),
        len(rows),
        len(frequency),
        len(frequency) - len(rows),
        (within_f.sum(), within_l.sum(), within[rows, columns].sum()),
        len(rows),
        seconds,
    )


def bands(truth: Truth, seed: int) -> tuple[int, int]:
    """Return how many modes three random bands hold, and how many agree with the whole band."""
    rng = np.random.default_rng(seed)
    whole = updyn.identify_modes(truth.frf)
    asked = agree = 0
    for _ in range(3):
        low = rng.uniform(2.0, 400.0)
        high = rng.uniform(low + 200.0, 800.0)
        held = [k for k, f in enumerate(whole.frequency) if 1.05 * low < f < 0.95 * high]
        if not held:
            continue
        part = updyn.identify_modes(truth.frf, band=(low, high))
        for k in held:
            off = np.abs(part.frequency - whole.frequency[k])
            std = np.hypot(part.std_frequency, whole.std_frequency[k])
            agree += bool((off <= 3.0 * std).any())
            asked += 1
    return asked, agree


def ours(truth: Truth) -> Score:
    """Return the score of `updyn.identify_modes`."""
    begin = time.process_time()
    found = updyn.identify_modes(truth.frf)
    seconds = time.process_time() - begin
    std = found.std_frequency, found.std_loss_factor
    return score(truth, found.frequency, found.loss_factor, *std, covering(found, truth), seconds)


def covering(found: updyn.ModeSet, truth: Truth) -> np.ndarray:
    """Return of each shape found the share of its components that cover those of each true one."""
    if found.std_shapes is None:
        return np.zeros((len(found), len(truth.frequency)))
    true = truth.shapes[[int(str(dof).split(":")[0]) - 1 for dof in found.dofs]]
    true = true / np.linalg.norm(true, axis=0)
    length = np.linalg.norm(found.real_shapes, axis=0)
    shapes, std = found.real_shapes / length, found.std_shapes / length
    signed = np.sign(shapes.T @ true)  # (found, true)
    off = np.abs(shapes[:, :, None] * signed - true[:, None, :])
    return np.mean(off <= 1.96 * std[:, :, None], axis=0)


def sdypy(truth: Truth) -> Score:
    """Return the score of sdypy-EMA with picks at the true frequencies."""
    from sdypy import EMA

    begin = time.process_time()
    values = truth.frf.values.reshape(len(truth.frf.freq), -1).T
    low, high = BAND
    model = EMA.Model(values, truth.frf.freq, lower=low, upper=high, pol_order_high=100)
    model.get_poles(show_progress=False)
    model.select_closest_poles(truth.frequency)
    poles = np.array(model.nat_freq), 2.0 * np.array(model.nat_xi)
    return score_picked(truth, *poles, time.process_time() - begin)


def pyoma2(truth: Truth) -> Score:
    """Return the score of pyOMA2's pLSCF with picks at the true frequencies."""
    from pyoma2.functions import gen, plscf

    begin = time.process_time()
    values, freq = truth.frf.values, truth.frf.freq
    if values.shape[2] > values.shape[1]:  # by reciprocity; the denominator is the smaller matrix
        values = values.transpose(0, 2, 1)
    order = -(-200 // values.shape[2])
    # Only the two highest orders are used: those below, each a fit of its own, are left out.
    plscf.trange = lambda *_: range(order - 1, order + 1)
    spectra = np.ascontiguousarray(values.transpose(1, 2, 0))
    # It takes the first line as 0 Hz, so its poles are shifted by that line.
    step = 0.5 / (freq[-1] - freq[0])
    _, _, shapes, poles = plscf.pLSCF_poles(*plscf.pLSCF(spectra, step, order, 1), step, "per", 1)
    poles = poles + 2j * np.pi * freq[0] * np.sign(poles.imag)
    natural = np.abs(poles) / (2 * np.pi)
    loss = -2.0 * poles.real / np.abs(poles)
    stable = gen.SC_apply(natural, loss, shapes, 1, 1, 1, 0.01, 0.05, 0.03)[:, 1] == 1
    stable &= poles.imag[:, 1] > 0
    natural, loss = natural[stable, 1], loss[stable, 1]
    off = np.abs(natural[:, None] / truth.frequency - 1.0)
    rows, _ = scipy.optimize.linear_sum_assignment(off)
    return score_picked(truth, natural[rows], loss[rows], time.process_time() - begin)


def score_picked(truth: Truth, frequency, loss, seconds: float) -> Score:
    """Return the score of poles without standard deviations."""
    missing = np.full(len(frequency), np.nan)
    within = np.zeros((len(frequency), len(truth.frequency)))
    return score(truth, frequency, loss, missing, missing, within, seconds)


def row(name: str, scores: list[Score]) -> str:
    """Return a line of the table."""
    modes, found = sum(s.modes for s in scores), sum(s.found for s in scores)
    returned, spurious = sum(s.returned for s in scores), sum(s.spurious for s in scores)
    asked = max(1, sum(s.asked for s in scores))
    covered = (100.0 * sum(s.covered[k] for s in scores) / asked for k in (0, 1, 2))
    # Without noise the fit is exact, and states no deviation; hits at other places have no shape.
    case = CASES[name]
    noisy = case.noise > 0 or case.real is not None
    f, d, phi = (f"{share:.0f} %" if noisy else "-" for share in covered)
    if case.real is not None and case.real.hits:
        phi = "-"
    seconds = np.median([s.seconds for s in scores])
    return (
        f"| {name} | {modes} | {100 * found / modes:.1f} % |"
        f" {100 * spurious / max(1, returned):.1f} % | {f} | {d} | {phi} | {seconds:.1f} |"
    )


def main() -> None:
    """Print the table."""
    asked = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    asked.add_argument("--cases", default=";".join(CASES))
    asked.add_argument("--draws", type=int, default=10)
    asked.add_argument("--peer", choices=["sdypy", "pyoma2"])
    asked.add_argument("--bands", action="store_true", help="compare three random bands")
    options = asked.parse_args()
    identify = {None: ours, "sdypy": sdypy, "pyoma2": pyoma2}[options.peer]
    print(
        "| case | modes | found | spurious | coverage, frequency | loss factor | shape | seconds |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name in options.cases.split(";"):
        scores = [identify(drawn(CASES[name], seed)) for seed in range(options.draws)]
        print(row(name, scores), flush=True)
        if options.bands:
            counts = [bands(drawn(CASES[name], seed), seed) for seed in range(options.draws)]
            asked_of, agree = (sum(c[k] for c in counts) for k in (0, 1))
            print(f"  the same in three random bands: {agree} of {asked_of}", flush=True)


if __name__ == "__main__":
    main()
