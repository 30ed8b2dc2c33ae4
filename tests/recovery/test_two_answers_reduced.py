"""Other answers that fit as well are found in the reduced tier as in an exact one, and certified."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp

import updyn

FREQ = np.linspace(8.0, 70.0, 60)
TRUE = {"left.stiffness": 1.5, "right.stiffness": 0.7}
IMAGE = {"left.stiffness": 0.7, "right.stiffness": 1.5}


def plate(m: int) -> updyn.Model:
    """A square of m x m masses on springs, m odd, held along one side, that is its own mirror image by design.

    Left and right of the middle column the halves have a stiffness each.
    """
    n = m * m
    node, column = np.arange(n).reshape(m, m), np.tile(np.arange(m), m)
    i = np.r_[node[:-1].ravel(), node[:, :-1].ravel()]
    j = np.r_[node[1:].ravel(), node[:, 1:].ravel()]
    left, right = (
        np.minimum(column[i], column[j]) < m // 2,
        np.maximum(column[i], column[j]) > m // 2,
    )

    def group(own: np.ndarray, mass: np.ndarray, loss: float) -> updyn.Group:
        k = int(own.sum())
        place = (np.tile(np.arange(k), 2), np.r_[i[own], j[own]])
        ends = sp.csr_array((np.r_[np.ones(k), -np.ones(k)], place), shape=(k, n))
        return updyn.Group(1e6 * ends.T @ ends, sp.diags_array(1.0 * mass), loss_factor=loss)

    groups = {
        "left": group(left, column < m // 2, 0.01),
        "right": group(right, column > m // 2, 0.01),
        "middle": group(~left & ~right, column == m // 2, 0.02),
        "support": updyn.Group(
            sp.diags_array(np.where(np.arange(n) < m, 1e6, 0.0)), loss_factor=0.01
        ),
    }
    return updyn.Model.from_groups(groups, [f"{d + 1}:Z" for d in range(n)])


def on_the_axis(m: int) -> list[str]:
    return [f"{row * m + m // 2 + 1}:Z" for row in (m - 1, 2 * m // 3, m // 3)]


def aside(m: int) -> str:
    return f"{(2 * m // 3) * m + 2}:Z"


def measured(model: updyn.Model, sensors: list[str], freq: np.ndarray = FREQ) -> updyn.FRF:
    true = model.scaled({"left": {"stiffness": 1.5}, "right": {"stiffness": 0.7}})
    clean = updyn.response(true, freq, sensors, sensors[:1])
    draw = np.random.default_rng(0).standard_normal((2, *clean.values.shape))
    values = clean.values * (1.0 + 0.01 * (draw[0] + 1j * draw[1]) / np.sqrt(2.0))
    return updyn.FRF(clean.freq, values, clean.responses, clean.references, clean.quantity)


def everything(model: updyn.Model) -> updyn.ParameterSet:
    return updyn.parameters(model, stiffness="all", mass=["left", "right"], loss_factor="all")


def deviations(values: dict[str, float], truth: dict[str, float], std: dict[str, float]) -> float:
    return max(abs(values[name] - truth[name]) / std[name] for name in truth)


def check_both(found: updyn.UpdateResult) -> updyn.Alternative:
    """The two answers are truth and mirror image, and the status says it; return the other one."""
    (other,) = found.alternatives
    answers = [found.values, other.values]
    if answers[0]["left.stiffness"] < 1.0:
        answers.reverse()
    widest = dict.fromkeys(TRUE, max(found.std[name] for name in TRUE))
    for values, expected in zip(answers, (TRUE, IMAGE), strict=True):
        assert deviations(values, expected, widest) < 4.0
    assert other.odds == pytest.approx(1.0, abs=0.1)
    assert found.status == "not-identifiable"
    assert found.identifiability.complete
    assert "2 answers fit the data equally well" in found.message
    assert found.remedy.startswith(f"A sensor at {other.sensor} would distinguish them")
    return other


def test_a_mirror_image_is_found_as_in_the_exact_tier():
    model = plate(9)
    frf = measured(model, on_the_axis(9))
    exact, reduced = (
        updyn.update(model, frf, everything(model), tier=t) for t in ("dense", "reduced")
    )
    others = [check_both(found) for found in (exact, reduced)]
    assert reduced.options["error"] <= reduced.options["accuracy"]
    # the same two answers, whichever is the result
    sides = [
        sorted(one.values["left.stiffness"] for one in both)
        for both in zip((exact, reduced), others, strict=True)
    ]
    np.testing.assert_allclose(sides[0], sides[1], rtol=1e-4)
    assert others[0].difference == pytest.approx(others[1].difference, rel=1e-3)


def test_a_model_that_is_reduced_by_default_names_a_sensor_that_settles_it():
    model = plate(25)
    found = updyn.update(model, measured(model, on_the_axis(25)), everything(model))
    assert found.options["tier"] == "reduced"
    check_both(found)
    there = updyn.update(model, measured(model, [*on_the_axis(25), aside(25)]), everything(model))
    assert (there.status, there.alternatives) == ("converged", ())
    assert deviations(there.values, TRUE, there.std) < 4.0


@pytest.mark.parametrize("options", [{"starts": 0}, {"method": "log"}])
def test_fits_that_do_not_look_elsewhere_say_nothing_of_it(options):
    model = plate(9)
    found = updyn.update(
        model, measured(model, on_the_axis(9)), everything(model), tier="reduced", **options
    )
    assert found.alternatives == ()


def test_a_run_that_is_stopped_while_it_looks_keeps_its_answer():
    model = plate(9)

    def stop(step: updyn.Progress) -> bool:
        return step.stage == "other answers"

    frf = measured(model, on_the_axis(9))
    found = updyn.update(model, frf, everything(model), tier="reduced", callback=stop)
    assert found.status == "stopped"
    sides = TRUE if found.values["left.stiffness"] > 1.0 else IMAGE
    for name, value in sides.items():
        assert found.values[name] == pytest.approx(value, rel=0.02)


def carrying(m: int, stiff: float) -> updyn.Model:
    """The plate with a mass on its middle, on a mount that is stiff within the band."""
    plain = plate(m)
    n, at = plain.n_dofs, plain.n_dofs // 2

    def wider(A: sp.sparray | None) -> sp.csr_array | None:
        if A is None:
            return None
        return sp.block_diag([A, sp.csr_array((1, 1))], format="csr")

    groups = {
        name: updyn.Group(wider(g.stiffness), wider(g.mass), loss_factor=g.loss_factor)
        for name, g in plain.groups.items()
    }
    ends = ([1.0, -1.0], ([0, 0], [at, n]))
    stretch = sp.csr_array(ends, shape=(1, n + 1))
    mass = sp.csr_array(([20.0], ([n], [n])), shape=(n + 1, n + 1))
    groups["mount"] = updyn.Group(stiff * stretch.T @ stretch, mass, loss_factor=0.05)
    return updyn.Model.from_groups(groups, [*plain.dofs.labels, f"{n + 1}:Z"])


def test_the_far_end_of_a_valley_is_found_as_in_the_exact_tier():
    """A resonance above the band holds the mount from below only."""
    true = carrying(9, 4e8)
    start = true.scaled({"mount": {"stiffness": 1.2}, "left": {"stiffness": 1.1}})
    sensors = [f"{node}:Z" for node in (81, 41, 20, 60)]
    clean = updyn.response(true, np.linspace(5.0, 60.0, 60), sensors, sensors[:1])
    draw = np.random.default_rng(1).standard_normal((2, *clean.values.shape))
    values = clean.values * (1.0 + 0.06 * (draw[0] + 1j * draw[1]) / np.sqrt(2.0))
    frf = updyn.FRF(clean.freq, values, sensors, sensors[:1], "receptance")
    unknowns = updyn.parameters(start, stiffness=["left", "right", "mount"], mass="mount")
    exact, reduced = (updyn.update(start, frf, unknowns, tier=t) for t in ("dense", "reduced"))
    for found in (exact, reduced):
        (end,) = found.alternatives
        assert found.status == "not-identifiable"
        assert end.values["mount.stiffness"] > 20.0 * found.values["mount.stiffness"]
        assert "mount.stiffness" in found.message
    ends = [found.alternatives[0] for found in (exact, reduced)]
    for name, value in ends[0].values.items():
        share = 0.1 if name == "mount.stiffness" else 1e-3
        assert ends[1].values[name] == pytest.approx(value, rel=share)
    assert np.log(ends[1].odds) == pytest.approx(np.log(ends[0].odds), abs=0.3)
