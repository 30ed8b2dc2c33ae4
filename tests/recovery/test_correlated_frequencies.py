"""Updates to natural frequencies with correlated errors: generalised least squares."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

import updyn
from updyn.modal import ModeSet, RepeatedTests
from updyn.model import Group, Model

N = 6


def spring(i: int) -> np.ndarray:
    v = np.zeros(N)
    v[i] = 1.0
    if i:
        v[i - 1] = -1.0
    return 2e4 * np.outer(v, v)


#: Stiffness at a factor of 1: the springs near the support, and the others.
PARTS = {"lower": sum(spring(i) for i in range(3)), "upper": sum(spring(i) for i in range(3, N))}
TRUE = np.array([1.2, 0.9])


def chain() -> Model:
    """Six masses of 1 kg on springs, held at one end."""
    groups = {name: Group(K) for name, K in PARTS.items()} | {"masses": Group(mass=np.eye(N))}
    return Model.from_groups(groups, [f"{i + 1}:X" for i in range(N)])


def true_frequencies() -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz and the derivatives of their logarithms by the factors, by SciPy alone."""
    value, phi = scipy.linalg.eigh(sum(x * K for x, K in zip(TRUE, PARTS.values(), strict=True)))
    slopes = [np.einsum("im,ij,jm->m", phi, K, phi) / (2.0 * value) for K in PARTS.values()]
    return np.sqrt(value) / (2.0 * np.pi), np.stack(slopes, axis=1)


#: Errors of the frequencies as shares: a common one, as of the temperature, and smaller ones.
SHARES = 1e-4 * np.diag([1.0, 1.5, 0.5, 1.0, 2.0, 1.0])
COVARIANCE = SHARES @ (0.9 * np.ones((N, N)) + 0.1 * np.eye(N)) @ SHARES


def fit(modes: ModeSet) -> tuple[np.ndarray, np.ndarray]:
    """Estimates and standard deviations of the two factors."""
    model = chain()
    unknowns = updyn.parameters(model, stiffness=list(PARTS))
    result = updyn.update(model, modes, unknowns, starts=0)
    assert result.status == "converged"
    return np.array(list(result.values.values())), np.array(list(result.std.values()))


def generalised(weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Covariance that least squares with a weight state, and the true covariance (Aitken 1935)."""
    _, J = true_frequencies()
    stated = np.linalg.solve(J.T @ weight @ J, np.eye(J.shape[1]))
    gain = stated @ J.T @ weight
    return stated, gain @ COVARIANCE @ gain.T


def measured_modes(frequency: np.ndarray, error: np.ndarray) -> dict[str, ModeSet]:
    """Frequencies with errors, with their covariance and with its diagonal alone."""
    found, size = frequency * np.exp(error), np.sqrt(np.diag(COVARIANCE)) * frequency
    covariance = COVARIANCE * np.outer(frequency, frequency)
    return {
        "known": ModeSet(found, cov_frequency=covariance),
        "ignored": ModeSet(found, std_frequency=size),
    }


WEIGHTS = {
    "known": np.linalg.solve(COVARIANCE, np.eye(N)),
    "ignored": np.diag(1.0 / np.diag(COVARIANCE)),
}


def test_standard_deviations_are_those_of_generalised_least_squares() -> None:
    for name, modes in measured_modes(true_frequencies()[0], np.zeros(N)).items():
        values, std = fit(modes)
        stated, actual = (np.sqrt(np.diag(one)) for one in generalised(WEIGHTS[name]))
        assert values == pytest.approx(TRUE, rel=1e-6)
        assert std == pytest.approx(stated, rel=1e-3)
        # Without the covariance, the stated deviations are not those of the estimates.
        assert (stated == pytest.approx(actual, rel=1e-6)) == (name == "known")


@pytest.mark.usefixtures("no_causes")
def test_a_common_error_is_covered_if_it_is_known() -> None:
    """Monte Carlo: a factor on all stiffnesses has the error of the mean, which does not average.

    By Aitken's formula, the deviation that independent errors state is 0.47 times the true one.
    """
    model, rng = chain(), np.random.default_rng(0)
    whole = updyn.link(model, "whole.stiffness", {f"{part}.stiffness": 1.0 for part in PARTS})
    frequency = np.sqrt(np.linalg.eigvalsh(sum(PARTS.values()))) / (2.0 * np.pi)
    errors = rng.multivariate_normal(np.zeros(N), COVARIANCE, 30, method="cholesky")
    covered = {"known": 0, "ignored": 0}
    for error in errors:
        for name, modes in measured_modes(frequency, error).items():
            result = updyn.update(model, modes, whole, starts=0)
            off = abs(result.values["whole.stiffness"] - 1.0)
            covered[name] += off < 1.96 * result.std["whole.stiffness"]
    assert covered["known"] >= 27
    assert covered["ignored"] <= 22


def test_tests_of_a_table_are_fitted_with_their_covariance(tmp_path: Path) -> None:
    """Sixty tests with gaps; the record keeps the covariance."""
    frequency, J = true_frequencies()
    rng = np.random.default_rng(1)
    errors = rng.multivariate_normal(np.zeros(N), 100.0 * COVARIANCE, 60, method="cholesky")
    table = frequency * np.exp(errors)
    table[rng.random(table.shape) < 0.1] = np.nan
    lines = [",".join(f"{value:.9f}" for value in row) for row in table]
    (tmp_path / "tests.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    modes = updyn.read_modes(tmp_path / "tests.csv")
    tests = RepeatedTests(table)
    assert modes.cov_frequency == pytest.approx(tests.covariance_of_mean, rel=1e-6)
    model = chain()
    result = updyn.update(model, modes, updyn.parameters(model, stiffness=list(PARTS)), starts=0)
    shares = tests.covariance_of_mean / np.outer(tests.mean, tests.mean)
    expected = np.linalg.solve(J.T @ np.linalg.solve(shares, J), np.eye(2))
    assert result.covariance == pytest.approx(expected, rel=0.02)
    updyn.write_result(result, tmp_path / "run.nc")
    again = updyn.read_result(tmp_path / "run.nc")
    assert again.data.digest == modes.digest
    assert again.data.cov_frequency.tolist() == modes.cov_frequency.tolist()
