"""A finished update is brought back to its problem: its likelihood is the Gaussian of Laplace, whatever the noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import updyn
from uncertain_cases import noisy, springs
from updyn.errors import OptionError
from updyn.uncertainty.restored import restore

LINES = np.linspace(1.0, 9.0, 60)


def model() -> updyn.Model:
    groups = {
        "base": updyn.Group(springs((0, 1, 1000.0), n=2), np.diag([1.0, 0.0]), loss_factor=0.03),
        "top": updyn.Group(springs((1, 2, 600.0), n=2), np.diag([0.0, 1.0]), loss_factor=0.05),
    }
    return updyn.Model.from_groups(groups, ["1:X", "2:X"])


def data(**extra) -> updyn.FRF:
    frf = updyn.response(model(), LINES, ["1:X", "2:X"], ["1:X"])
    return replace(
        noisy(frf, 3, 0.01),
        **{k: np.full(frf.values.shape, v) for k, v in extra.items() if k != "averages"},
    )


VARIANCE = (0.01 * np.abs(updyn.response(model(), LINES, ["1:X", "2:X"], ["1:X"]).values)) ** 2

CASES = {
    "stated": ({}, {"relative": 0.01}),
    "estimated": ({}, None),
    "by channel": ({}, "estimated-by-channel"),
    "robust": ({}, {"source": "estimated", "robust": "student-t"}),
    "robust, stated": ({}, {"relative": 0.01, "robust": "student-t"}),
    "coherence": ({"coherence": 1 / (1 + 0.01**2 * 50)}, "coherence"),
    "variance": ({"variance": 1.0}, "variance"),
}


@pytest.mark.parametrize("case", CASES)
def test_every_kind_of_noise(case) -> None:
    extra, noise = CASES[case]
    frf = data(**extra)
    if case == "variance":
        frf = replace(frf, variance=VARIANCE)
    if case == "coherence":
        frf = replace(frf, averages=50)
    if case.startswith("robust"):  # one line is far off
        values = frf.values.copy()
        values[20] *= 3.0
        frf = replace(frf, values=values)
    result = updyn.update(
        model(),
        frf,
        updyn.parameters(model(), stiffness="all", loss_factor="all"),
        noise=noise,
        starts=0,
    )
    setting = restore(result)
    top = setting.likelihood().descend(setting.x)
    names = result.parameters.names
    std = np.array([result.std[n] for n in names])
    values = setting.problem.coordinates.to_values(top.x)
    assert (np.abs(values - [result.values[n] for n in names]) < 0.05 * std).all()
    slope = setting.problem.coordinates.slope(top.x)
    C = np.linalg.solve(top.local.R.T @ top.local.R, np.eye(4)) * slope * slope[:, None]
    np.testing.assert_allclose(np.sqrt(np.diag(C)), std, rtol=0.03)
    # A bootstrap begins with the same kind of noise, estimated again where it was.
    (begun,) = setting.initial_noises()
    assert begun.kind == result.noise["kind"]
    draws = updyn.bootstrap(result, 3)
    assert (np.abs(draws.values - values) < 5 * std).all()


def test_data_that_were_held_out_and_lines_that_were_not_used_stay_out() -> None:
    result = updyn.update(
        model(), data(), updyn.parameters(model(), stiffness="all"), lines=LINES[::2], validation=["2:X"],
        noise={"relative": 0.01}, starts=0,
    )  # fmt: skip
    (part,) = restore(result).problem.parts
    frf = part.frf
    np.testing.assert_array_equal(frf.freq, LINES[::2])
    assert list(frf.responses.labels) == ["1:X"]


def test_damping_in_other_units_keeps_them() -> None:
    """Rayleigh coefficients are scaled inside; profiles and draws are in their own unit."""
    base = model()
    frf = updyn.response(base, LINES, ["1:X", "2:X"], ["1:X"])
    rayleigh = updyn.parameters(base, stiffness="all", stiffness_damping=["base"])
    result = updyn.update(base, noisy(frf, 0, 0.01), rayleigh, noise={"relative": 0.01}, starts=0)
    name = next(n for n in result.parameters.names if n.endswith("stiffness_damping"))
    one = updyn.profile(result, name, starts=0)[name]
    assert one.lower == 0.0 or one.lower > result.values[name] - 3 * result.std[name]
    assert one.upper < result.values[name] + 3 * result.std[name]


def test_a_regularised_fit_has_no_likelihood() -> None:
    result = updyn.update(
        model(), data(), updyn.parameters(model(), stiffness="all"), regularise="gcv", starts=0
    )
    with pytest.raises(OptionError, match="give the unknowns priors"):
        updyn.profile(result)
