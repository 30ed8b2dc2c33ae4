"""What follows an update in a reduced model begins with its basis, and finds what it would without."""

from __future__ import annotations

import gc
import pickle
import weakref
from dataclasses import replace

import numpy as np
import pytest

import updyn
from uncertain_cases import noisy

N, LINES, PARTS = 400, np.linspace(2.0, 12.0, 50), 4
SENSORS = ["400:X", "310:X", "200:X", "120:X"]
FORCE = SENSORS[:1]


@pytest.fixture(scope="module")
def result() -> updyn.UpdateResult:
    """A chain of 400 masses in four parts."""
    K, M = np.zeros((PARTS, N, N)), np.zeros((PARTS, N, N))
    for i in range(N):
        part = i * PARTS // N
        M[part, i, i] = 1.0
        K[part, i, i] += 5e6
        if i:
            K[part, i - 1, i - 1] += 5e6
            K[part, [i - 1, i], [i, i - 1]] -= 5e6
    groups = {
        f"part {p + 1}": updyn.Group(K[p], M[p], loss_factor=0.02 + 0.01 * p) for p in range(PARTS)
    }
    model = updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(N)])
    truth = model.scaled({"part 2": {"stiffness": 1.1}, "part 3": {"stiffness": 0.95}})
    frf = noisy(updyn.response(truth, LINES, SENSORS, FORCE), 0, 0.02)
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    found = updyn.update(model, frf, unknowns, noise={"relative": 0.02}, tier="reduced", starts=0)
    assert found.ok
    return found


@pytest.fixture(scope="module")
def alone(result) -> updyn.UpdateResult:
    """The same as read from a file."""
    return replace(result, kept_basis=None)


def test_it_is_that_of_the_start_and_of_its_band(result) -> None:
    kept = result.kept_basis
    assert kept is not None
    assert kept.model is result.start
    assert kept.band == (LINES[0], LINES[-1])
    assert kept.basis.size == result.options["basis"]


def test_a_file_and_a_pickle_leave_it_out(result, tmp_path) -> None:
    updyn.write_result(result, tmp_path / "run.nc")
    assert updyn.read_result(tmp_path / "run.nc").kept_basis is None
    again = pickle.loads(pickle.dumps(result))  # noqa: S301
    assert again.kept_basis is None
    assert again.values == result.values


def test_it_goes_with_the_result(result) -> None:
    unknowns = result.parameters
    own = updyn.update(
        result.start, result.frf, unknowns, noise={"relative": 0.02}, tier="reduced", starts=0
    )
    assert own.kept_basis is not None
    vectors = own.kept_basis.basis._blocks[0]
    seen = weakref.ref(vectors if vectors.base is None else vectors.base)
    del own, vectors
    gc.collect()
    assert seen() is None


def test_a_profile_is_the_same_without_it(result, alone) -> None:
    name = "part 2.stiffness"
    found, expected = updyn.profile(result, [name]), updyn.profile(alone, [name])
    assert found.intervals()[name] == pytest.approx(
        expected.intervals()[name], abs=1e-3 * result.std[name]
    )


def test_draws_and_bands_are_the_same_without_it(result, alone) -> None:
    found, expected = updyn.bootstrap(result, 6), updyn.bootstrap(alone, 6)
    std = np.array([result.std[name] for name in found.names])
    assert (np.abs(found.values - expected.values) <= 1e-3 * std).all()
    about = LINES, ["200:X", "77:X"], FORCE  # one of them was not measured
    for one, other in ((found, expected), (result, alone)):
        own, new = updyn.predict(one, *about), updyn.predict(other, *about)
        largest = np.abs(new.frf.values).max(axis=(1, 2), keepdims=True)
        assert (np.abs(own.frf.values - new.frf.values) <= 2e-5 * largest).all()
        np.testing.assert_allclose(own.lower, new.lower, rtol=2e-3)
        np.testing.assert_allclose(own.upper, new.upper, rtol=2e-3)


def test_an_analysis_does_not_depend_on_those_before(result) -> None:
    name = "part 3.stiffness"
    first = updyn.profile(result, [name])
    updyn.bootstrap(result, 2)
    updyn.predict(result, LINES, SENSORS, FORCE)
    updyn.plant(result, FORCE, FORCE, (LINES[0], LINES[-1]))
    assert updyn.profile(result, [name]).intervals() == first.intervals()


def test_a_plant_is_that_of_the_updated_model(result, alone) -> None:
    asked = FORCE, SENSORS[:2], (LINES[0], LINES[-1]), 0.005
    H = updyn.response(result.model, LINES, SENSORS[:2], FORCE).values
    fine = np.linspace(LINES[0], LINES[-1], 600)
    peak = np.abs(updyn.response(result.model, fine, SENSORS[:2], FORCE, tier="reduced").values)
    peak = peak.max(axis=0)
    for given in (result, alone, result.model):
        made = updyn.plant(given, *asked, error="peak")
        assert (np.abs(made.response(LINES).values - H) <= 0.005 * peak).all()
    family = updyn.plant_family(result, *asked, error="peak", n=3)
    expected = updyn.plant_family(alone, *asked, error="peak", n=3)
    np.testing.assert_array_equal(family.values, expected.values)
    difference = np.abs(family.response(LINES) - expected.response(LINES))
    assert (difference <= 2 * 0.005 * 1.2 * peak).all()  # each against the peak of its own model


def test_a_wider_band_begins_anew(result) -> None:
    lines = np.linspace(1.0, 25.0, 60)
    band = updyn.predict(result, lines, ["200:X"], FORCE)
    H = updyn.response(result.model, lines, ["200:X"], FORCE, tier="sparse").values
    assert (np.abs(band.frf.values - H) <= 1e-5 * np.abs(H)).all()
