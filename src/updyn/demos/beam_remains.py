"""What the beam demo says at its end: a table of the runs, and what remains. Every figure is computed from the runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from updyn.correlation import Correlation, correlate
from updyn.demos.beam import BAND, HAMMER, LENGTH, OTHER_E, SENSORS, STATIONS, E
from updyn.dynamics.modes import modes

if TYPE_CHECKING:
    from updyn.frf import FRF
    from updyn.updating.result import UpdateResult

__all__ = ["comparison", "levels_of", "one_mode", "reciprocity", "remains", "torsion"]

#: Sensor and hammer point of the same station: some millimetres apart, the third at one node.
_PAIRS = tuple(zip(SENSORS[:6], HAMMER, strict=True))
_BANDS = ((BAND[0], 300.0), (300.0, 1000.0), (1000.0, 2200.0), (2200.0, BAND[1]))


def comparison(results: Sequence[UpdateResult]) -> str:
    """Return a table of the start and of every run: fitted and held-out sensors, over all lines of the band."""
    first = results[0]
    rows = [
        (
            f"start, E = {E / 1e9:g} GPa",
            first.correlation["before"],
            first.correlation["validation"]["before"],
        )
    ]
    rows += [
        (r.title, r.correlation["after"], r.correlation["validation"]["after"]) for r in results
    ]
    held = ", ".join(first.validation_responses)
    lines = [
        (
            f"Over all {len(first.frf.freq)} lines from {BAND[0]:g} to {BAND[1]:g} Hz, medians "
            f"({len(first.lines)} lines were fitted; held out: {held}):"
        ),
        f"{'':<24} {'fitted sensors':>20}   {'held-out sensors':>20}",
        f"{'':<24} {'|dB|':>10} {'FRAC':>9}   {'|dB|':>10} {'FRAC':>9}",
    ]
    for name, fitted, other in rows:
        cells = [f"{x['db_error_median']:>10.3f} {x['frac_median']:>9.3f}" for x in (fitted, other)]
        lines.append(f"{name:<24} {'   '.join(cells)}")
    return "\n".join(lines) + "\n\n" + _start(first)


def _start(result: UpdateResult) -> str:
    """Say what the start is worth: with another handbook value of E it would look much better."""
    other = result.start.scaled({"beam": {"stiffness": OTHER_E / E}})
    figures = correlate(other, result.frf.select(responses=result.fitted_responses)).figures()
    return (
        f"The start has the dimensions inferred from these FRFs and a handbook E of {E / 1e9:g}"
        " GPa. Its FRAC is near 0 because resonances as sharp as these miss each other when"
        f" frequencies are off by per cents: with {OTHER_E / 1e9:g} GPa, a handbook value too, the"
        f" start would read {figures['db_error_median']:.2f} dB and {figures['frac_median']:.2f}."
        " Judge by what is reached, not by how far it came. (A fit weighs every value by its"
        " noise, resonances and antiresonances alike; medians may go either way.)"
    )


def remains(result: UpdateResult) -> str:
    """Say what of the measurement the last model does not explain, and why."""
    computed = correlate(result.model, result.frf)
    error = computed.db_error
    levels = ", ".join(
        f"{np.median(error[(computed.freq >= a) & (computed.freq < b)]):.2f} dB in {a:g}-{b:g} Hz"
        for a, b in _BANDS
    )
    apart = 1e3 * max(abs(STATIONS[int(s[:3])] - STATIONS[int(h[:3])]) for s, h in _PAIRS)
    twisted, mac = torsion(computed, LENGTH)
    swapped, unexplained = reciprocity(computed.measured, computed.computed)
    frequency = next(f for f in modes(result.model, 4).frequency if f > BAND[0])
    found, ours = (one_mode(frf, frequency)[1] for frf in (computed.measured, computed.computed))
    return "\n".join(
        [
            f"What remains of '{result.title}', and why:",
            f"- By band: {levels}.",
            (
                f"- A mode at {twisted:.0f} Hz is missing from the model, and the shapes agree"
                f" least around it (CSAC {computed.csac.min():.2f}). At the sensors it moves much"
                f" as the first torsion of a free bar would (MAC {mac:.2f}), struck and measured"
                " off the axis; a beam that bends in one plane has no torsion."
            ),
            (
                "- Swapping hammer and sensor between stations changes the measurement by"
                f" {swapped:.1%} (median). The two are up to {apart:.1f} mm apart there;"
                f" {unexplained:.1%} is more than the model can put down to that: torsion,"
                " calibration, repeatability."
            ),
            (
                "- Each sensor lies off the model by a level of its own (calibration, or position),"
                " which is no unknown: "
                f"{', '.join(f'{k} {v:+.2f}' for k, v in levels_of(computed.measured, computed.computed).items())} dB."
            ),
            (
                f"- Mode 1 is measured with a loss factor of {found:.2%}; the model gives it"
                f" {ours:.2%}. The foam under the ends dissipates otherwise than two springs with"
                " one loss factor. Loss factors that differ between segments are the nearest that"
                " the model has to it: read them as that, not as a finding about the steel."
            ),
            (
                "- Length, section and positions were inferred, and the form of the model chosen,"
                " with sight of all sensors, the held-out ones included, and so was the number of"
                " segments (benchmarks/beam.py has others). Segments that differ by a few per cent"
                " may as well be positions that are off by millimetres. Suspension modes, below 60"
                " Hz, are not modelled."
            ),
        ]
    )


def reciprocity(measured: FRF, computed: FRF) -> tuple[float, float]:
    """Return how far H_ij / H_ji is from 1 over pairs of stations, and how far from that of the model: medians."""

    def ratio(frf: FRF) -> NDArray[np.complex128]:
        H = frf.select(responses=[s for s, _ in _PAIRS], references=[h for _, h in _PAIRS]).values
        i, j = np.triu_indices(len(_PAIRS), 1)
        return np.asarray(H[:, i, j] / H[:, j, i])

    found, expected = ratio(measured), ratio(computed)
    return float(np.median(np.abs(found - 1.0))), float(np.median(np.abs(found / expected - 1.0)))


def levels_of(measured: FRF, computed: FRF) -> dict[str, float]:
    """Return the level of each sensor against the model, in dB: median over lines, mean over hammer points."""
    level = np.median(
        20.0 * np.log10(np.abs(measured.values) / np.abs(computed.values)), axis=0
    ).mean(axis=1)
    return dict(zip(measured.responses.labels, level.tolist(), strict=True))


def torsion(computed: Correlation, length: float) -> tuple[float, float]:
    """Find the mode around the line where shapes agree least, in what the model does not explain.

    Parameters
    ----------
    computed : Correlation
        Model against measurement.
    length : float
        Of the beam, in m.

    Returns
    -------
    frequency : float
        Its natural frequency in Hz.
    mac : float
        Of its shape with cos(pi x / length), the first torsion mode of a free bar.
    """
    measured = computed.measured
    rest = replace(measured, values=measured.values - computed.computed.values)
    frequency, _, residues = one_mode(rest, float(computed.freq[computed.csac.argmin()]))
    shape = np.linalg.svd(residues)[0][:, 0]
    twist = np.cos(np.pi * np.array([STATIONS[d.node] for d in measured.responses]) / length)
    return frequency, float(np.abs(shape @ twist) ** 2 / (twist @ twist))


def one_mode(frf: FRF, near: float) -> tuple[float, float, NDArray[np.complex128]]:
    """Fit one mode to all channels at once: a pole and a constant in receptance, least squares in accelerance.

    Parameters
    ----------
    frf : FRF
        Accelerances.
    near : float
        About where it is, in Hz; lines to 5 % on each side are used.

    Returns
    -------
    frequency, loss_factor : float
        In Hz, and dimensionless.
    residues : ndarray of complex, shape (n_responses, n_references)
        Up to a factor.
    """
    from scipy.optimize import least_squares

    part = frf.select(band=(0.95 * near, 1.05 * near))
    square = (part.freq / near) ** 2
    Y = part.values.reshape(len(square), -1)

    def amplitudes(pole: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any]]:
        ratio, loss = pole
        shapes = square[:, None] * np.column_stack(
            [1.0 / (ratio * (1.0 + 1j * loss) - square), np.ones(len(square))]
        )
        found = np.linalg.lstsq(shapes, Y, rcond=None)[0]
        return found, Y - shapes @ found

    def misfit(pole: NDArray[np.float64]) -> NDArray[np.float64]:
        r = amplitudes(pole)[1].ravel()
        return np.concatenate([r.real, r.imag])

    pole = least_squares(misfit, [1.0, 0.01], x_scale=[0.01, 0.01]).x
    residues = amplitudes(pole)[0][0].reshape(part.values.shape[1:])
    return near * float(np.sqrt(pole[0])), float(pole[1]), residues
