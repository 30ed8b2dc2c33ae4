"""Updating to modes inside a reduced model gives what the full model gives, also for close modes."""

from __future__ import annotations

import importlib
import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.elements.structure import PointMass, Shell, Spring, structure
from updyn.errors import OptionError
from updyn.modal import ModeSet
from updyn.modal.settings import MODE_REDUCTION
from updyn.updating.fit.reducing import are_modes_reduced
from updyn.updating.problem.modal import ModalPart
from updyn.updating.problem.noise.modes import ModalNoise

ROOT = Path(__file__).parents[2]
#: Folder of the files that benchmarks/airmod.py reads.
AIRMOD = Path(os.environ.get("UPDYN_AIRMOD", "no-folder"))
M = 16  # elements along a side
TRUTH = {"west": 1.3, "north": 0.8, "east": 1.2, "mount": 0.6, "motor": 1.4}


@cache
def plate() -> updyn.Model:
    """A square plate of 1 m in four quarters on four springs, with a mass near its middle; 1734 DOFs.

    Its symmetry gives close pairs of modes.
    """
    x, y = (a.ravel() for a in np.meshgrid(np.arange(M + 1), np.arange(M + 1), indexing="ij"))
    nodes = {i + 1: [x[i] / M, y[i] / M, 0.0] for i in range(len(x))}
    quads = np.array(
        [
            [i * (M + 1) + j + 1, (i + 1) * (M + 1) + j + 1, (i + 1) * (M + 1) + j + 2, i * (M + 1) + j + 2]
            for i in range(M)
            for j in range(M)
        ]
    )  # fmt: skip
    i, j = np.divmod(np.arange(M * M), M)
    names = np.array([["west", "south"], ["north", "east"]])[(i >= M // 2) * 1, (j >= M // 2) * 1]
    steel = {"E": 2.1e11, "rho": 7850.0, "nu": 0.3, "thickness": 0.01}
    parts = [
        Shell(name, quads[names == name], **steel) for name in ("west", "south", "north", "east")
    ]
    corners = [1, M + 1, M * (M + 1) + 1, (M + 1) ** 2]
    parts += [Spring("mount", node, stiffness=[2e7, 2e7, 5e3, 0, 0, 0]) for node in corners]
    parts.append(PointMass("motor", M // 2 * (M + 1) + M // 2 + 2, 4.0))
    return structure(nodes, parts)


def changed(factors: dict[str, float]) -> updyn.Model:
    quantity = {"motor": "mass"}
    return plate().scaled(
        {name: {quantity.get(name, "stiffness"): f} for name, f in factors.items()}
    )


def unknowns() -> updyn.ParameterSet:
    return updyn.parameters(plate(), stiffness=["west", "north", "east", "mount"], mass=["motor"])


def sensors() -> list[str]:
    return [f"{node}:Z" for node in range(1, (M + 1) ** 2 + 1, 23)]


def measure(model: updyn.Model, n: int, *, shapes: bool = True) -> ModeSet:
    """The lowest elastic modes of a model."""
    found = updyn.modes(model, n + 6)
    found = found.select(np.flatnonzero(found.frequency > 0)[:n])
    std = 1e-3 * found.frequency
    if not shapes:
        return ModeSet(found.frequency, std_frequency=std)
    return ModeSet(found.frequency, found.at(sensors()), sensors(), std_frequency=std)


def part_of(data: ModeSet, *, reduced: bool) -> ModalPart:
    return ModalPart.build(plate(), data, unknowns(), ModalNoise(), reduced=reduced)


#: Logarithms of the factors: the start, the truth, and far away.
POINTS = [np.zeros(5), np.log(list(TRUTH.values())), np.log([0.4, 2.5, 0.7, 3.0, 0.5])]


@pytest.mark.parametrize("shapes", [False, True])
def test_modes_and_derivatives_are_those_of_the_full_model(shapes: bool) -> None:
    data = measure(changed(TRUTH), 12, shapes=shapes)
    full, reduced = part_of(data, reduced=False), part_of(data, reduced=True)
    closest = 1.0
    for x in POINTS:
        exact, found = full.pairs(x), reduced.pairs(x)
        assert np.array_equal(found.which, exact.which)
        n = exact.n_used
        assert found.modes.frequency[:n] == pytest.approx(exact.modes.frequency[:n], rel=1e-7)
        closest = min(
            closest, (np.diff(exact.modes.frequency[:n]) / exact.modes.frequency[1:n]).min()
        )
        rows, expected = reduced.rows(x, shapes=shapes), full.rows(x, shapes=shapes)
        assert np.abs(rows.r - expected.r).max() < 1e-6
        along, step = np.random.default_rng(0).standard_normal(len(x)), 1e-4
        ahead, behind = (
            full.rows(x + s * step * along, derivatives=False, shapes=shapes).r for s in (1, -1)
        )
        slope = (ahead - behind) / (2 * step)
        far = np.abs(rows.J @ along - slope)
        assert far.max() < 5e-3 * np.abs(slope).max()
        assert far[rows.of("frequency")].max() < 1e-4
    assert closest < 2e-3
    assert reduced.reduction is not None
    assert reduced.reduction.modes.size < 200


def test_stated_errors_cover_the_true_ones() -> None:
    data = measure(changed(TRUTH), 12, shapes=False)
    full, part = part_of(data, reduced=False), part_of(data, reduced=True)
    assert part.reduction is not None
    reduced = part.reduction.modes
    state, about = [part.state(x) for x in POINTS], (12, part.target.highest)
    reduced.lowest(state[0], *about)
    for one, x in zip(state, POINTS, strict=True):
        for _ in range(3):
            modes = reduced.lowest(one, *about)
            errors = reduced.bound_errors(modes, one, 12)
            exact = full.pairs(x).modes
            true = np.abs(modes.frequency[:12] / exact.frequency[:12] - 1.0)
            assert (true <= errors.frequency + 1e-8).all()
            if reduced.certify_or_enrich(one, part.values(x), modes, 12):
                break


@pytest.mark.parametrize("shapes", [False, True])
def test_update_agrees_with_that_of_the_full_model(shapes: bool) -> None:
    data = measure(changed(TRUTH), 12, shapes=shapes)
    noise = {"frequency": 1e-3} | ({"shape": 0.02} if shapes else {})
    full, reduced = (
        updyn.update(plate(), data, unknowns(), tier=tier, noise=noise, starts=0)
        for tier in ("sparse", "reduced")
    )
    assert [name.partition(".")[0] for name in reduced.values] == list(TRUTH)
    for name, true in zip(reduced.values, TRUTH.values(), strict=True):
        assert reduced.std[name] == pytest.approx(full.std[name], rel=0.01)
        assert abs(reduced.values[name] - full.values[name]) < 0.01 * full.std[name]
        if shapes:  # the mirror image has the same frequencies
            assert abs(reduced.values[name] - true) < 0.05 * full.std[name]
    assert "tier" not in full.options
    assert reduced.options["tier"] == "reduced"
    assert reduced.options["frequency error"] < 1e-6
    assert "Solved in a reduced model of" in reduced.summary()


def test_frfs_and_modes_are_fitted_together_in_reduced_models() -> None:
    def damped(model: updyn.Model) -> updyn.Model:
        groups = {
            name: replace(group, loss_factor=0.0 if group.stiffness is None else 0.02)
            for name, group in model.groups.items()
        }
        return updyn.Model.from_groups(groups, model.dofs)

    frf = updyn.response(
        damped(changed(TRUTH)), np.linspace(20.0, 120.0, 40), ["1:Z", "100:Z"], ["1:Z"]
    )
    tests = [
        updyn.Test(damped(plate()), frf, "frfs", noise={"relative": 0.01}),
        updyn.Test(damped(plate()), measure(changed(TRUTH), 8), "modes"),
    ]
    joint = updyn.update_jointly(tests, unknowns(), tier="reduced", starts=0)
    assert joint.status == "converged"
    assert list(joint.values.values()) == pytest.approx(list(TRUTH.values()), rel=1e-5)
    used = [result.options for result in joint.results.values()]
    assert used[0]["error"] < 1e-5
    assert used[1]["frequency error"] < 1e-6


def test_large_models_are_reduced_by_default() -> None:
    assert not are_modes_reduced(None, 3000)
    assert are_modes_reduced(None, 3001)
    assert not are_modes_reduced("sparse", 3001)
    data = measure(changed(TRUTH), 8, shapes=False)
    options = {"starts": 0, "max_iterations": 1}
    used = updyn.update(
        plate(), data, unknowns(), tier="reduced", backend="superlu", **options
    ).options
    assert used["backend"] == "superlu"
    with pytest.raises(OptionError, match="backend: modes of a full model"):
        updyn.update(plate(), data, unknowns(), backend="superlu", **options)


def test_a_missed_mode_is_found_at_the_end_of_the_fit() -> None:
    """A basis without one of the modes at the start: the others are accurate, and do not show it."""
    data = measure(plate(), 10, shapes=False)
    part = part_of(data, reduced=True)
    assert part.reduction is not None
    x, reduced = POINTS[0], part.reduction.modes
    modes = reduced.lowest(part.state(x), 10, part.target.highest)
    keep = np.arange(len(modes.value)) != 6
    reduced._restart(replace(modes, value=modes.value[keep], shapes=modes.shapes[:, keep]))
    assert not part.confirm(x)
    assert part.confirm(x)
    exact = part_of(data, reduced=False).pairs(x).modes.frequency
    assert part.pairs(x).modes.frequency[:10] == pytest.approx(exact[:10], rel=1e-7)


def test_fits_end_after_three_that_the_full_model_does_not_confirm(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = []
    monkeypatch.setattr(ModalPart, "confirm", lambda part, x: bool(asked.append(x)))
    data = measure(changed(TRUTH), 8, shapes=False)
    result = updyn.update(plate(), data, unknowns(), tier="reduced", starts=0, max_iterations=2)
    assert len(asked) == 3
    assert result.options["frequency error"] == "not checked where the fit ended"


def test_factors_far_apart_do_not_share_a_factorisation() -> None:
    part = part_of(measure(changed(TRUTH), 8, shapes=False), reduced=True)
    assert part.reduction is not None
    counts = []
    for x in (0.0, 1e-5, np.log(MODE_REDUCTION.least_ratio) - 0.1):
        part.rows(np.full(5, x))
        counts.append(part.reduction.modes.factorisations)
    assert counts[0] == counts[1] < counts[2]


def test_resumed_run_has_the_same_result(tmp_path) -> None:
    data = measure(changed(TRUTH), 8, shapes=False)
    about = plate(), data, unknowns()
    options = {"starts": 0, "tier": "reduced"}
    stored = options | {"checkpoint": tmp_path / "run.ckpt"}
    updyn.update(*about, max_iterations=2, **stored)
    resumed = updyn.update(*about, resume=True, **stored)
    assert resumed.options["tier"] == "reduced"
    assert resumed.values == updyn.update(*about, **options).values


@pytest.mark.skipif(not AIRMOD.is_dir(), reason="UPDYN_AIRMOD names no folder")
def test_airmod_has_the_frequencies_of_its_tests(monkeypatch: pytest.MonkeyPatch) -> None:
    """18 unknowns of the aircraft model of DLR, 14 natural frequencies of its repeated tests."""
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    airmod = importlib.import_module("airmod")
    model, data = airmod.read(AIRMOD), airmod.tested(AIRMOD)
    unknowns = airmod.unknowns(model)
    before = airmod.identifiability(model, data, unknowns, noise={"frequency": 1e-4})
    assert (before.rank, before.n_parameters) == (14, 18)
    result = updyn.update(model, data, unknowns)
    assert result.status == "not-identifiable"
    assert result.identifiability.rank <= 14
    assert result.options["tier"] == "reduced"
    assert result.options["frequency error"] < 1e-5
    assert np.abs(airmod.errors(result.model, data)).max() < 0.01
