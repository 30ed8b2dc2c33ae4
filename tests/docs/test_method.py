"""docs/method.md: its constants are those of the code, its claims of the paper's example hold."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

import updyn
from places import ROOT
from updyn.demos.gear_train import starting_model, table, true_model
from updyn.dynamics.settings import BASIS, CERTIFICATE, LINE_SOLVER, REDUCTION, SHIFTED
from updyn.linalg.settings import SPARSE_SOLVER
from updyn.updating.fit import search
from updyn.updating.fit.settings import (
    ANSWER_RESIDUAL,
    ANSWERS,
    FURTHER_ANSWERS,
    NULL_SPACE,
    REDUCED_FIT,
    REDUCED_TIER,
    SEARCH,
    SEARCH_BASIS,
    TRY_STARTS,
)
from updyn.updating.judge.settings import EXPERIMENT_ADVICE
from updyn.updating.problem import noise, residuals
from updyn.updating.problem.noise import estimated
from updyn.updating.problem.noise.settings import LINE_SCATTER
from updyn.updating.problem.settings import LINE_DESIGN, SEARCH_DATA

TEXT = " ".join((ROOT / "docs" / "method.md").read_text(encoding="utf-8").split())


@pytest.mark.parametrize(
    "said",
    [
        f"s_i < {NULL_SPACE.rank_tolerance:.0e}".replace("e-0", "e-"),
        f"standard deviation exceeds {NULL_SPACE.undetermined_std:g} ",
        f"at most {SEARCH.most_lines} lines",
        "at least {:g}, then {:g}, then {:.1f}".format(*TRY_STARTS.loss_levels),
        f"`starts` tries ({search.Search().starts}) of {search.Search().max_iterations} steps",
        f"values down to {SEARCH_DATA.least_loss_factor:g} ",
        f"by more than {100 * FURTHER_ANSWERS.uncertain_std:g} % is moved alone",
        f"w = 1 / sqrt(1 + (s / {SEARCH_DATA.halving_noise:g})^2)",
        f"s^2 = E|dH|^2 / (|H_X|^2 - {SEARCH_DATA.subtracted_variances:g} E|dH|^2)",
        f"below {residuals.ROUNDING.receptance_share:.0e} of the largest of its line",
        f"whose log error is at most {SEARCH.fitted_cost_ratio:g} times the least",
        "Factors are moved by up to {:.0f} or {:.0f} %".format(
            *(100 * far for far in TRY_STARTS.nearby_logs)
        ),
        f"loss factors by {TRY_STARTS.nearby_loss:g}; every",
        f"or {TRY_STARTS.nearby_ratio * search.Search().starts} have found nothing better",
        {0.5: "half of the band"}[TRY_STARTS.band_share] + ", or any third of the lines",
        f"size leaves once in {1 / ANSWER_RESIDUAL.least_probability:.0f} times",
        f"within a factor {math.exp(search.Search().spread):.1f} of the start",
        f"with a standard deviation above {100 * FURTHER_ANSWERS.movable_std:g} %,",
        f"within {math.exp(ANSWERS.equal_log_odds):.0f} to 1 fit equally well",
        f"differ there by {100 * EXPERIMENT_ADVICE.distinct_difference:g} % or more",
        (
            f"noise of {100 * noise.ASSUMED['relative']:g} % and a floor of"
            f" {100 * noise.ASSUMED['floor']:g} %"
        ),
        f"a floor of {100 * LINE_DESIGN.noise_floor:g} % of the rms",
        f"Up to {LINE_SOLVER.dense_dofs} degrees of freedom",
        (
            f"up to {LINE_SOLVER.filled_dofs} where more than {100 * LINE_SOLVER.dense_fill:g} % of the"
            " matrix is filled"
        ),
    ],
)
def test_constants_are_as_documented(said: str) -> None:
    assert said in TEXT


def gear_train(omega: list[float]) -> updyn.UpdateResult:
    start = starting_model(1)
    test = updyn.response(
        true_model(), np.array(omega) / (2 * np.pi), [f"{i}:RZ" for i in (1, 2, 3, 4)], ["2:RZ"]
    )
    unknowns = updyn.parameters(start, stiffness="all", mass="all", loss_factor="all")
    return updyn.update(start, test, unknowns, method="equation-error")


def test_the_floor_of_lines_is_described() -> None:
    text = " ".join((ROOT / "docs" / "noise.md").read_text(encoding="utf-8").split())
    assert f"by a factor of {estimated._SHRUNK:.3f}, which is divided out" in text
    assert LINE_SCATTER.least_lines == 20
    assert "fewer than twenty lines" in text
    assert f"E|dH|^2 ~ sum over {LINE_SCATTER.window_lines} lines" in text


def test_the_paper_determines_17_of_18() -> None:
    result = gear_train([10, 20, 50, 100])
    assert (result.status, result.identifiability.rank, len(result.parameters)) == (
        "not-identifiable",
        17,
        18,
    )
    true = [g.loss_factor for g in true_model().groups.values()]
    np.testing.assert_allclose(
        [g.loss_factor for g in result.model.groups.values()], true, atol=1e-9
    )
    (direction,) = result.identifiability.null_directions
    assert max(direction, key=lambda name: abs(direction[name])) == "unit 6.stiffness"
    assert set(direction) == {f"unit {e}.{q}" for e in (1, 5) for q in ("mass", "stiffness")} | {
        "unit 6.mass",
        "unit 6.stiffness",
    }
    assert "determine 17 of the 18 unknowns" in TEXT


def test_a_fifth_line_makes_it_18() -> None:
    assert gear_train([10, 20, 50, 75, 100]).identifiability.rank == 18


def test_sums_of_the_tables() -> None:
    data = table()
    K5, K6 = (np.array(data["stiffness_units_1e6"][e]) for e in (4, 5))
    assert (K5[1, 1] + K6[0, 0], K6[0, 1]) == pytest.approx((153.991, 18.0806))
    printed = np.array([153.51 / 153.991, 18.02 / 18.0806]) - 1
    assert [round(-100 * p, 2) for p in printed] == [0.31, 0.34]
    M = data["mass_units"]
    assert M[0][1][1] + M[1][0][0] + M[4][0][0] == pytest.approx(1291.951)


def test_the_identity_of_the_residuals() -> None:
    rng = np.random.default_rng(3)
    Z_A, Z_X = (z + z.T for z in rng.normal(size=(2, 5, 5)) + 1j * rng.normal(size=(2, 5, 5)))
    H_A, H_X = np.linalg.solve(Z_A, np.eye(5)), np.linalg.solve(Z_X, np.eye(5))
    np.testing.assert_allclose(H_A - H_X, H_A @ (Z_X - Z_A) @ H_X, atol=1e-12)


def test_one_factor_on_everything_divides_the_receptance() -> None:
    model = true_model()
    more = model.scaled({name: {"stiffness": 1.03, "mass": 1.03} for name in model.groups})
    sides = (["1:RZ", "4:RZ"], ["2:RZ"])
    freq = np.linspace(1.0, 20.0, 7)
    expected = updyn.response(model, freq, *sides).values / 1.03
    np.testing.assert_allclose(updyn.response(more, freq, *sides).values, expected, rtol=1e-9)


def test_every_source_is_cited_and_every_citation_has_its_source() -> None:
    text, sources = TEXT.split("## Sources")
    cited = {
        int(n) for group in re.findall(r"\[(\d+(?:, \d+)*)[\],]", text) for n in group.split(", ")
    }
    listed = {int(n) for n in re.findall(r"(?:^| )(\d+)\. [A-Z]\. [A-Z]", sources)}
    assert cited == listed == set(range(1, len(listed) + 1))


def test_the_numbers_of_large_models_are_those_of_the_code() -> None:

    section = TEXT.split("## Large models")[1].split("## ")[0]
    assert (
        f"up to {LINE_SOLVER.dense_dofs} DOFs ({LINE_SOLVER.filled_dofs} where the matrix is full)"
        in section
    )
    assert (
        f"above {REDUCED_TIER.most_exact_dofs} DOFs with {REDUCED_TIER.least_lines} lines or more"
        in section
    )
    assert f"`accuracy` ({REDUCTION.accuracy:g}".replace("e-05", "e-5") in section
    assert "twice the difference to the answer in a larger basis" in section
    assert "sixteen times r_i^T P^-1 r_j at the four lines" in section
    assert (CERTIFICATE.difference_factor, CERTIFICATE.residual_factor) == (2.0, 16.0)
    assert CERTIFICATE.residual_lines == 4
    assert "rounding: 2 eps" in section
    assert "0.5 eps" in section
    assert (CERTIFICATE.entry_rounding, CERTIFICATE.factor_rounding) == (2.0, 0.5)
    assert "at least 8 and at most 24" in section
    assert (SEARCH_BASIS.least_points, SEARCH_BASIS.most_points) == (8, 24)
    assert "s = 0.2, 0.5 and 0.8 omega_max^2 in turn" in section
    assert REDUCTION.further_shifts == (0.2, 0.5, 0.8)
    assert "loss factors of 0 to 0.3" in section
    assert ANSWERS.loss_spread == 0.3
    words = " ".join(section.split())
    assert "in rounds of at most 12 steps" in words
    assert "in a new basis where the one before ended, 12 at most" in words
    assert "within a fiftieth of a factor of that of the basis" in words
    assert pytest.approx(0.02) == REDUCED_FIT.enriched_share * REDUCED_FIT.radius
    assert f"Above {REDUCED_FIT.heavy_dofs:,} DOFs, where three factorisations" in words
    assert "a fifth (the trust radius) is sufficient" in words
    assert pytest.approx(0.2) == REDUCED_FIT.enriched_share_if_heavy * REDUCED_FIT.radius
    assert "more than a tenth off that of the last one" in words
    assert SHIFTED.close_share == 0.1
    assert f"Above {SHIFTED.double_dofs:,} DOFs it is made in single precision" in words
    assert "Up to a fifth, no eigenvalue changes its sign" in words
    assert SPARSE_SOLVER.largest_remaining_share == 0.2
    assert "refined to 1e-9 (of P below, 1e-5)" in words
    assert (BASIS.new_norm, SHIFTED.measuring_error) == (1e-9, 1e-5)
    assert "by 0.003 and then 0.01 of omega_max^2" in words
    assert SHIFTED.moves_in_single == (0.0, 3e-3, 1e-2)
    assert "too large above a fifth of the permitted error" in words
    assert REDUCTION.enriched_share == 0.2
    assert (REDUCED_FIT.steps_per_round, REDUCED_FIT.most_rounds) == (12, 12)
    assert "leaves more than 0.8 of the log error of the round before" in words
    assert REDUCED_FIT.slow_decrease == 0.8
    assert "fields of 40 other points" in section
    assert SEARCH_BASIS.samples == 40
    assert f"no further than {100 * REDUCED_FIT.radius:.0f} % of a factor" in section
