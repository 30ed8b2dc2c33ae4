"""Are the standard deviations right where sensors are off by what their prior says? Repeated measurements tell."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from cause_search import no_cause_search

FREQ = np.linspace(1.0, 40.0, 40)
GAIN, NOISE, RUNS = 0.05, 0.02, 12
TRUE = {
    "part1": {"stiffness": 1.1},
    "part2": {"stiffness": 0.9, "stiffness_damping": 3e-4},
    "part3": {"mass_damping": 2.0},
}


def chain(n: int = 5) -> updyn.Model:
    groups = {}
    for e in range(n):
        K, M = np.zeros((n, n)), np.zeros((n, n))
        at = [e] if e == 0 else [e - 1, e]
        K[np.ix_(at, at)] = (
            3e4 * (1 + 0.2 * e) * (np.ones((1, 1)) if e == 0 else np.array([[1, -1], [-1, 1]]))
        )
        M[e, e] = 1.0 + 0.3 * e
        groups[f"part{e + 1}"] = updyn.Group(K, M, 0.02)
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


@pytest.fixture(scope="module")
def scores() -> dict[str, np.ndarray]:
    """Errors in standard deviations of all unknowns in all runs, with and without calibration factors."""
    model, rng = chain(), np.random.default_rng(11)
    exact = updyn.response(model.scaled(TRUE), FREQ, model.dofs, ["1:X"], "accelerance").values
    unknowns = updyn.parameters(
        model, stiffness=["part1", "part2"], stiffness_damping="part2", mass_damping="part3"
    )
    out: dict[str, list[list[float]]] = {"with": [], "without": []}
    for _ in range(RUNS):
        gains = np.exp(GAIN * rng.standard_normal(5))
        noise = rng.standard_normal(exact.shape) + 1j * rng.standard_normal(exact.shape)
        values = exact * gains[:, None] * (1.0 + NOISE * noise / np.sqrt(2.0))
        frf = updyn.FRF(FREQ, values, model.dofs, ["1:X"], "accelerance")
        true = {f"{g}.{q}": v for g, change in TRUE.items() for q, v in change.items()}
        true |= {f"{i + 1}:X.calibration": gain for i, gain in enumerate(gains.tolist())}
        factors = updyn.calibration(frf, prior_std=GAIN)
        for which, chosen in (("without", unknowns), ("with", unknowns + factors)):
            with no_cause_search():
                found = updyn.update(model, frf, chosen, noise={"relative": NOISE}, starts=0)
            # The stated noise counts: an inflation would hide what the factors are for.
            stated = 1.0 if which == "with" else found.noise["inflation"]
            out[which].append(
                [(found.values[n] - true[n]) / found.std[n] * stated for n in chosen.names]
            )
    return {which: np.array(rows) for which, rows in out.items()}


def test_errors_are_as_large_as_the_standard_deviations(scores: dict[str, np.ndarray]) -> None:
    """108 scores of unit variance, correlated within a run: their root mean square is 1 within a quarter."""
    assert np.sqrt(np.mean(scores["with"] ** 2)) == pytest.approx(1.0, abs=0.25)
    assert np.mean(np.abs(scores["with"]) < 1.96) == pytest.approx(0.95, abs=0.06)


def test_without_calibration_factors_they_are_not(scores: dict[str, np.ndarray]) -> None:
    # The standard deviations hold part of the sensors' error, as an error of the model: 2.8. The
    # root mean square of 48 scores of unit variance is above 1.5 with a probability of 2e-6.
    assert np.sqrt(np.mean(scores["without"] ** 2)) > 2.5
