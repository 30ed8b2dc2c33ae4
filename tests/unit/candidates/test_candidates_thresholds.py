"""The numbers that decide the order of candidates, and whether they are distinguishable."""

from __future__ import annotations

import numpy as np
import pytest

from updyn.candidates.bands import divide_lines
from updyn.candidates.result import CandidateRow, ModelComparison, rank_candidates


def row(name, log_evidence, scores=(0.0, 0.0), n_unknowns=3, *, adequate=True):
    result = None
    about = (name, "converged", "", n_unknowns, 0, log_evidence, tuple(scores), 1.0, adequate)
    return CandidateRow(*about, result)


def first(*rows):
    ranked, criterion = rank_candidates(rows)
    return ranked[0].name, criterion


@pytest.mark.parametrize(("deficit", "expected"), [(0.9, "simple"), (1.1, "rich")])
def test_of_equal_evidence_the_simpler_is_first(deficit, expected):
    """Odds of at most e are not worth more than a bare mention."""
    rows = row("rich", 10.0, n_unknowns=5), row("simple", 10.0 - deficit, n_unknowns=3)
    assert first(*rows) == (expected, "evidence")


@pytest.mark.parametrize(("deficit", "distinct"), [(2.8, False), (3.2, True)])
def test_strong_evidence_is_odds_of_20(deficit, distinct):
    rows, criterion = rank_candidates([row("a", 10.0), row("b", 10.0 - deficit)])
    found = ModelComparison(rows, criterion, ((1.0, 2.0), (2.0, 3.0)))
    assert found.distinguishable is distinct


@pytest.mark.parametrize(("deficit", "expected"), [(0.8, "simple"), (1.25, "rich")])
def test_one_standard_error_of_the_score_goes_to_the_simpler(deficit, expected):
    """Differences by band of mean -d / 4 and standard deviation 1 / 2: the error of the sum is 1."""
    each = 0.5 * np.array([1.0, 1.0, -1.0, -1.0]) * np.sqrt(3 / 4) - deficit / 4
    rows = (
        row("rich", 0.0, np.zeros(4), 5, adequate=False),
        row("simple", -500.0, each, 3, adequate=False),
    )
    assert first(*rows) == (expected, "predictive score")


@pytest.mark.parametrize(("deficit", "distinct"), [(2.9, False), (3.5, True)])
def test_scores_are_distinguishable_beyond_chance(deficit, distinct):
    """Student's quantile of 95 % on both sides with 3 degrees of freedom is 3.18."""
    each = 0.5 * np.array([1.0, 1.0, -1.0, -1.0]) * np.sqrt(3 / 4) - deficit / 4
    rows, criterion = rank_candidates(
        [row("a", 0.0, np.zeros(4), adequate=False), row("b", 5.0, each, adequate=False)]
    )
    found = ModelComparison(rows, criterion, ((1.0, 2.0),) * 4)
    assert criterion == "predictive score"
    assert found.is_distinguishable("b") is distinct


def test_candidates_without_a_fit_are_last():
    rows = [row("a", -np.inf, (np.nan, np.nan), adequate=False), row("b", -3.0)]
    assert first(*rows) == ("b", "evidence")
    rows[1] = row("b", -3.0, adequate=False)
    assert first(*rows) == ("b", "predictive score")
    ranked, criterion = rank_candidates(rows)
    found = ModelComparison(ranked, criterion, ((1.0, 2.0),) * 2)
    assert not found.distinguishable
    assert "the fit of a failed" in found.statement
    assert "a converged: " in found.summary()
    none, criterion = rank_candidates(rows[:1])
    assert ModelComparison(none, criterion, ((1.0, 2.0),)).statement == "No candidate was fitted."


def test_bands_are_contiguous_and_complete():
    bands = divide_lines([7, 5], 3)
    assert [len(band[0]) for band in bands] == [3, 2, 2]
    for part, n in ((0, 7), (1, 5)):
        np.testing.assert_array_equal(np.concatenate([band[part] for band in bands]), np.arange(n))
