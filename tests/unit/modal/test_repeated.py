"""Mean frequencies of repeated tests: their covariance, with gaps and with few tests."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest

from updyn.errors import DataError
from updyn.modal import ModeSet, RepeatedTests
from updyn.modal.settings import REPEATED_TESTS

MEAN = np.array([10.0, 20.0, 35.0])
STD = np.array([0.1, 0.3, 0.2])
CORRELATION = np.array([[1.0, 0.8, -0.3], [0.8, 1.0, 0.1], [-0.3, 0.1, 1.0]])
COVARIANCE = CORRELATION * STD[:, None] * STD


def draw(tests: int, seed: int = 0, gaps: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    found = rng.multivariate_normal(MEAN, COVARIANCE, tests)
    found[rng.random(found.shape) < gaps] = np.nan
    return found


def test_statistics_of_many_tests_are_those_of_the_population() -> None:
    tests = RepeatedTests(draw(4000))
    assert tests.mean == pytest.approx(MEAN, rel=1e-3)
    assert tests.std == pytest.approx(STD, rel=0.05)
    assert tests.correlation == pytest.approx(CORRELATION, abs=0.05)
    assert tests.covariance_of_mean == pytest.approx(tests.covariance / 4000, rel=1e-12)
    assert tests.shrinkage < 0.01


def test_shrinkage_is_that_of_schafer_and_strimmer() -> None:
    """Table 2, target D, of Stat. Appl. Genet. Mol. Biol. 4 (2005) 32, written in loops."""
    table = draw(9)
    n = len(table)
    z = (table - table.mean(axis=0)) / table.std(axis=0, ddof=1)
    above = below = 0.0
    for i in range(3):
        for j in range(3):
            if i != j:
                w = [z[k, i] * z[k, j] for k in range(n)]
                middle = sum(w) / n
                below += (n / (n - 1) * middle) ** 2
                above += n / (n - 1) ** 3 * sum((one - middle) ** 2 for one in w)
    tests = RepeatedTests(table)
    assert 0.05 < above / below < 1.0
    assert tests.shrinkage == pytest.approx(above / below, rel=1e-10)
    expected = (1.0 - above / below) * np.corrcoef(table, rowvar=False)
    np.fill_diagonal(expected, 1.0)
    assert tests.correlation == pytest.approx(expected, abs=1e-12)


def test_the_covariance_of_means_with_gaps_is_that_of_their_scatter() -> None:
    """Monte Carlo: 2000 tables of 60 tests, of which mode 1 misses a half and mode 2 a third."""
    rng = np.random.default_rng(3)
    is_missing = np.stack([np.arange(60) % 2 == 0, np.arange(60) % 3 == 0, np.zeros(60, bool)], 1)
    means, stated = [], []
    for _ in range(2000):
        table = np.where(is_missing, np.nan, rng.multivariate_normal(MEAN, COVARIANCE, 60))
        means.append(np.nanmean(table, axis=0))
        if len(stated) < 200:
            stated.append(RepeatedTests(table).covariance_of_mean)
    scatter = np.cov(np.array(means), rowvar=False)
    size = np.sqrt(np.diag(scatter))
    found = np.mean(stated, axis=0)
    assert found / (size[:, None] * size) == pytest.approx(
        scatter / (size[:, None] * size), abs=0.1
    )


@pytest.mark.parametrize(("tests", "gaps"), [(2, 0.0), (5, 0.0), (8, 0.4), (40, 0.6)])
def test_the_covariance_is_positive_definite_for_few_tests(tests: int, gaps: float) -> None:
    rng = np.random.default_rng(1)
    table = 10.0 + rng.standard_normal((tests, 3)) @ rng.standard_normal((3, 14))
    table[rng.random(table.shape) < gaps] = np.nan
    table[:2] = np.where(np.isnan(table[:2]), 10.0 + rng.standard_normal((2, 14)), table[:2])
    found = RepeatedTests(table)
    assert np.diag(found.correlation) == pytest.approx(np.ones(14))
    for covariance in (found.covariance, found.covariance_of_mean):
        std = np.sqrt(np.diag(covariance))
        assert np.linalg.eigvalsh(covariance / (std[:, None] * std)).min() > 1e-4


def test_pairs_that_few_tests_share_count_as_uncorrelated() -> None:
    assert REPEATED_TESTS.least_common == 4
    table = np.array([[1.0, 1.1], [2.0, 2.2], [4.0, 4.1], [3.0, np.nan], [np.nan, 5.0]])
    assert RepeatedTests(table).correlation[0, 1] == 0.0
    table[3, 1] = 3.2
    assert RepeatedTests(table).correlation[0, 1] > 0.5


def test_equal_values_leave_the_matrix_positive_definite() -> None:
    """Frequencies at two lines of a spectrum: the correlation is 1, its estimated variance 0."""
    table = np.repeat(np.array([[10.0, 20.0], [10.5, 20.5]]), 4, axis=0)
    found = RepeatedTests(table)
    assert found.shrinkage == REPEATED_TESTS.least_shrinkage == 1e-3
    assert found.correlation[0, 1] == pytest.approx(0.999)


def test_modes_of_the_means() -> None:
    table = draw(30, gaps=0.2)
    table = np.column_stack([table[:, ::-1], np.full(30, np.nan), np.full(30, 50.0)])
    table[4, 3] = 60.0
    tests = RepeatedTests(table)
    modes = tests.mean_modes("tests.csv")
    assert modes.frequency == pytest.approx(np.sort(tests.mean))
    assert modes.source == "tests.csv"
    assert modes.cov_frequency[:3, :3] == pytest.approx(tests.covariance_of_mean[2::-1, 2::-1])
    # One test has the mode at 60 Hz, and all have the other one at 50 Hz: no scatter is known.
    assert np.isnan(modes.cov_frequency[3:]).all()
    assert np.isnan(modes.std_frequency[3:]).all()
    assert RepeatedTests(draw(1)).mean_modes().cov_frequency is None


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (np.zeros(3), r"expected \(tests, modes\), found an array of shape \(3,\)"),
        ([[1.0, np.nan], [2.0, np.nan]], "mode 2 was found in no test; leave its column out"),
        ([[1.0, -2.0]], "test 1, mode 2: -2 Hz; expected a finite frequency above 0"),
        ([[1.0, np.inf]], "test 1, mode 2: inf Hz; expected a finite frequency above 0"),
    ],
)
def test_refused_tables(table: object, message: str) -> None:
    with pytest.raises(DataError, match=message):
        RepeatedTests(table)


# -- the covariance of a set of modes ------------------------------------------------------------
def test_a_given_covariance_follows_the_modes() -> None:
    order = [2, 0, 1]
    modes = ModeSet(MEAN[order], cov_frequency=COVARIANCE[np.ix_(order, order)])
    assert modes.cov_frequency == pytest.approx(COVARIANCE)
    assert modes.std_frequency == pytest.approx(STD)
    assert modes.select([0, 2]).cov_frequency == pytest.approx(COVARIANCE[np.ix_([0, 2], [0, 2])])
    assert modes.renamed([]).cov_frequency == pytest.approx(COVARIANCE)
    assert modes.digest != ModeSet(MEAN, std_frequency=STD).digest
    assert modes.to_xarray()["cov_frequency"].attrs["units"] == "Hz^2"


def test_a_covariance_may_be_unknown_for_some_modes() -> None:
    covariance = COVARIANCE.copy()
    covariance[1] = covariance[:, 1] = np.nan
    modes = ModeSet(MEAN, cov_frequency=covariance)
    assert modes.std_frequency == pytest.approx([0.1, np.nan, 0.2], nan_ok=True)
    assert ModeSet(MEAN, cov_frequency=np.full((3, 3), np.nan)).cov_frequency is None


@pytest.mark.parametrize(("share", "is_accepted"), [(0.8, True), (1.2, False)])
def test_tolerances_of_covariances(share: float, is_accepted: bool) -> None:
    """Opposite correlations may differ by 1e-9, deviations by 1e-6 of themselves."""
    skew = COVARIANCE + share * 1e-9 * STD[:, None] * STD * np.triu(np.ones((3, 3)), 1)
    cases = ({}, skew), ({"std_frequency": (1.0 + share * 1e-6) * STD}, COVARIANCE)
    for given, covariance in cases:
        with nullcontext() if is_accepted else pytest.raises(DataError):
            ModeSet(MEAN, cov_frequency=covariance, **given)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"cov_frequency": np.eye(2)}, r"cov_frequency: expected shape \(3, 3\), found \(2, 2\)"),
        ({"cov_frequency": np.triu(np.ones((3, 3)))}, "cov_frequency: expected a symmetric matrix"),
        (
            {"cov_frequency": np.ones((3, 3))},
            "cov_frequency: expected a positive definite matrix; the least eigenvalue of its"
            " correlation matrix is .*; shrink",
        ),
        ({"cov_frequency": np.diag([1.0, -1.0, 1.0])}, "variance -1 at 20 Hz; expected a finite"),
        (
            {"cov_frequency": np.diag([1.0, np.nan, 1.0])},
            "cov_frequency of 10 and 20 Hz is 0; expected nan in the whole row and column",
        ),
        (
            {"cov_frequency": COVARIANCE, "std_frequency": [0.1, 0.3, 0.3]},
            "std_frequency at 35 Hz is 0.3, and the root of its variance in cov_frequency 0.2",
        ),
    ],
)
def test_refused_covariances(given: dict[str, object], message: str) -> None:
    with pytest.raises(DataError, match=message):
        ModeSet(MEAN, **given)
