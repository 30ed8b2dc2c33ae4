"""Updating inside a reduced model gives what the whole model gives, far from the start, with strong local damping."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

import updyn
from updyn.dynamics.affine import State
from updyn.dynamics.shifted import Shifted
from updyn.errors import OptionError
from updyn.linalg.solver import Factorised
from updyn.updating.fit.methods.maximum_likelihood import MaximumLikelihood
from updyn.updating.fit.reducing import Reducing, is_reduced
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.problem import FRFPart, Problem

M = 16
BAND = np.linspace(12.0, 90.0, 60)
SENSORS = ["250:Z", "133:Z", "70:Z", "201:Z", "9:-Z"]


def plate() -> updyn.Model:
    """A square of 256 masses on springs held along one side: two halves, a lossy seam between them, the support."""
    n = M * M
    node = np.arange(n).reshape(M, M)
    half = np.repeat(np.arange(M) >= M // 2, M)
    i = np.r_[node[:-1].ravel(), node[:, :-1].ravel()]
    j = np.r_[node[1:].ravel(), node[:, 1:].ravel()]

    def group(own: np.ndarray, mass: np.ndarray | None, loss: float) -> updyn.Group:
        k = int(own.sum())
        place = (np.tile(np.arange(k), 2), np.r_[i[own], j[own]])
        ends = sp.csr_array((np.r_[np.ones(k), -np.ones(k)], place), shape=(k, n))
        return updyn.Group(
            1e6 * ends.T @ ends,
            None if mass is None else sp.diags_array(1.0 * mass),
            loss_factor=loss,
        )

    groups = {
        "left": group(~half[i] & ~half[j], ~half, 0.01),
        "right": group(half[i] & half[j], half, 0.02),
        "seam": group(half[i] != half[j], None, 0.3),
        "support": updyn.Group(
            sp.diags_array(np.where(np.arange(n) < M, 1e6, 0.0)), loss_factor=0.01
        ),
    }
    return updyn.Model.from_groups(groups, [f"{d + 1}:Z" for d in range(n)])


NEAR = {"left": 1.3, "right": 0.8, "seam": 0.7, "support": 1.2}


def measured(model: updyn.Model, noise: float, change: dict[str, float] = NEAR) -> updyn.FRF:
    truth = model.scaled(
        {
            g: {"stiffness": k, "loss_factor": model.group(g).loss_factor * 1.5}
            for g, k in change.items()
        }
    )
    frf = updyn.response(truth, BAND, SENSORS, SENSORS[:1])
    rng = np.random.default_rng(0)
    draw = rng.standard_normal((2, *frf.values.shape))
    return updyn.FRF(
        BAND,
        frf.values * (1 + noise * (draw[0] + 1j * draw[1])),
        SENSORS,
        SENSORS[:1],
        "receptance",
    )


def test_where_a_fit_from_the_start_leaves_noise_nothing_is_searched() -> None:
    model = plate()
    frf = measured(model, 0.01)
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    near = updyn.update(model, frf, unknowns, tier="reduced", backend="superlu")
    local = updyn.update(model, frf, unknowns, tier="reduced", backend="superlu", starts=0)
    assert near.status == "converged"
    assert near.options["error"] <= near.options["accuracy"]
    assert not any(step.stage == "search" for step in near.history)
    for name in unknowns.names:
        assert abs(near.values[name] - local.values[name]) < 1e-2 * local.std[name]


def test_a_fit_from_the_start_goes_on_while_it_gets_better() -> None:
    """The way is more than twice as long as one basis holds."""
    model = plate()
    far = {"left": 1.7, "right": 0.6, "seam": 0.5, "support": 1.5}
    frf = measured(model, 0.01, far)
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    result = updyn.update(model, frf, unknowns, tier="reduced", backend="superlu")
    assert result.status == "converged"
    assert not any(step.stage == "search" for step in result.history)
    for group, factor in far.items():
        name = f"{group}.stiffness"
        assert abs(result.values[name] - factor) < 4.0 * result.std[name]


@pytest.mark.parametrize("method", ["maximum-likelihood", "log"])
def test_the_same_answer_as_the_whole_model(method: str) -> None:
    model = plate()
    frf = measured(model, 0.01)
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    whole = updyn.update(model, frf, unknowns, method, tier="sparse", backend="superlu", starts=0)
    fast = updyn.update(model, frf, unknowns, method, tier="reduced", backend="superlu", starts=0)
    assert (fast.status, whole.status) == ("converged", "converged")
    assert fast.options["tier"] == "reduced"
    assert fast.options["basis"] < model.n_dofs
    assert fast.options["error"] <= fast.options["accuracy"] == 1e-5
    assert 0.0 < fast.options["channel error"] < 0.01
    for name in unknowns.names:
        assert abs(fast.values[name] - whole.values[name]) < 1e-2 * whole.std[name]
        assert fast.std[name] == pytest.approx(whole.std[name], rel=1e-3)
    # The figures of the start are those of the reduced model of the start.
    for when in ("before", "after"):
        for key, value in whole.correlation[when].items():
            assert fast.correlation[when][key] == pytest.approx(value, rel=1e-3, abs=1e-4)


def far_off(seed: int) -> updyn.Model:
    true, rng = plate(), np.random.default_rng(seed)
    off = {g: {"stiffness": 1 + rng.uniform(-0.7, 0.7), "loss_factor": 0.0} for g in true.groups}
    for g in ("left", "right"):
        off[g]["mass"] = 1 + rng.uniform(-0.3, 0.3)
    return true.scaled(off)


def worst(found: updyn.UpdateResult, true: updyn.Model) -> float:
    """Largest error of an unknown in its standard deviations."""
    off = []
    for p in updyn.parameters(found.model, stiffness="all", mass="all", loss_factor="all"):
        if p.name not in found.values:
            continue
        value, own, group = found.values[p.name], found.model.group(p.group), true.group(p.group)
        error = value - group.loss_factor
        if p.quantity != "loss_factor":
            size = abs(getattr(own, p.quantity)).sum() / abs(getattr(group, p.quantity)).sum()
            error = value * (1.0 - 1.0 / size)
        off.append(abs(error) / found.std[p.name])
    return max(off)


@pytest.mark.parametrize("seed", [0, 3])
def test_starts_far_off_with_many_sensors(seed: int) -> None:
    # In the basis of the start, the search of the second draw misses, and the fit of the first can.
    true, start = plate(), far_off(seed)
    at = [f"{int(i)}:Z" for i in np.linspace(M * M, 9, 20)]
    frf = updyn.response(true, BAND, at, at[:1])
    draw = np.random.default_rng(seed).standard_normal((2, *frf.values.shape))
    values = frf.values * (1 + 0.01 * np.sqrt(0.5) * (draw[0] + 1j * draw[1]))
    frf = updyn.FRF(BAND, values, at, at[:1], "receptance")
    unknowns = updyn.parameters(start, stiffness="all", mass="all", loss_factor="all")
    found = updyn.update(start, frf, unknowns, tier="reduced", backend="superlu")
    assert found.status == "converged"
    assert found.options["error"] <= found.options["accuracy"]
    assert worst(found, true) < 4.0
    # 21 and more where each descent on the way goes no further from its basis than the fit does.
    assert found.options["factorisations"] <= 18


def test_the_factorisation_that_rounds_share_is_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    start = plate()
    names = list(start.groups)
    true = start.scaled({name: {"stiffness": 1.05} for name in names[:2]})
    frf = updyn.response(true, BAND, SENSORS, SENSORS[:1])
    draw = np.random.default_rng(0).standard_normal((2, *frf.values.shape))
    values = frf.values * (1 + 0.01 * np.sqrt(0.5) * (draw[0] + 1j * draw[1]))
    frf = updyn.FRF(BAND, values, frf.responses, frf.references, frf.quantity)
    definite, ended = [], []
    factorise, release = Shifted.factorise, Reducing.release

    def counted(self: Shifted, state: State, shift: float, **options: float) -> Factorised:
        definite.append(shift < 0.0)
        return factorise(self, state, shift, **options)

    def noted(self: Reducing) -> None:
        ended.append([part.reduction for part in self._parts])
        release(self)

    monkeypatch.setattr(Shifted, "factorise", counted)
    monkeypatch.setattr(Reducing, "release", noted)
    unknowns = updyn.parameters(start, stiffness=names)
    found = updyn.update(start, frf, unknowns, tier="reduced", backend="superlu")
    assert found.status == "converged"
    assert found.options["error"] <= found.options["accuracy"]
    # One at the start, for its figures; one for all that comes about the answer.
    assert sum(definite) <= 2
    assert sum(definite) < len(definite)
    ((reduction,),) = ended
    assert reduction.shifted._definite is None


def test_a_search_leaves_the_basis_of_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    start = far_off(0)
    frf = updyn.response(plate(), BAND, SENSORS, SENSORS[:1])
    unknowns = updyn.parameters(start, stiffness="all", mass="all", loss_factor="all")
    labels, added, stages = [], [], []
    search = MaximumLikelihood.search

    def noted(self, problem, noises, monitor):
        labels.append(problem.parts[0].solver.label)
        data = problem.parts[0].frf
        added.append(noises[0].initial_variance(data) - noises[0].base.initial_variance(data))
        return search(self, problem, noises, monitor)

    def in_the_search_or_after(progress):
        stages.append(progress.stage)
        return bool(labels) and progress.stage in ("search", "maximum-likelihood")

    monkeypatch.setattr(MaximumLikelihood, "search", noted)
    running = {"tier": "reduced", "backend": "superlu", "callback": in_the_search_or_after}
    updyn.update(start, frf, unknowns, **running)
    assert labels == ["reduced, around the start"]
    assert (added[0] > 0.0).all()  # the search knows that its basis is not exact
    stages.clear()
    updyn.update(start, frf, unknowns, **running, starts=0)
    assert "maximum-likelihood" in stages
    assert labels == ["reduced, around the start"]  # without a search its basis is not made


def test_stopped_while_another_basis_is_made() -> None:
    """What the descents from the start have reached by then is kept."""
    start = far_off(0)
    frf = updyn.response(plate(), BAND, SENSORS, SENSORS[:1])
    unknowns = updyn.parameters(start, stiffness="all", mass="all", loss_factor="all")
    stages = []

    def once_descended(progress):
        stages.append(progress.stage)
        return progress.stage == "reduce"

    found = updyn.update(
        start, frf, unknowns, tier="reduced", backend="superlu", callback=once_descended
    )
    assert "approach" in stages
    assert found.status == "stopped"

    def log_error(model):
        there = updyn.response(model, BAND, SENSORS, SENSORS[:1])
        return np.sum(np.abs(np.log(there.values / frf.values)) ** 2)

    assert log_error(found.model) < 0.8 * log_error(start)


def test_stopped_while_the_reduced_model_is_made() -> None:
    model = plate()
    frf = measured(model, 0.01)
    unknowns = updyn.parameters(model, stiffness="all")
    result = updyn.update(
        model, frf, unknowns, tier="reduced", callback=lambda progress: progress.stage == "start"
    )
    assert result.status == "stopped"
    assert list(result.values.values()) == [1.0] * 4


def test_which_models_are_reduced() -> None:
    assert is_reduced(None, 150_000, 200)
    assert not is_reduced(None, 150_000, 10)
    assert is_reduced(None, 3_000, 200)
    assert not is_reduced(None, 500, 200)
    assert is_reduced(None, 3_000, 200, regularise="gcv")
    assert not is_reduced(None, 3_000, 200, regularise="tsvd:3")
    assert not is_reduced("sparse", 150_000, 200)
    assert not is_reduced(None, 150_000, 200, "equation-error")
    assert is_reduced("reduced", 30, 2, "log")
    with pytest.raises(OptionError, match="condensed equation error needs"):
        is_reduced("reduced", 150_000, 200, "equation-error")
    with pytest.raises(OptionError, match="accuracy = 2"):
        updyn.update(
            plate(),
            measured(plate(), 0.0),
            updyn.parameters(plate(), stiffness="all"),
            tier="reduced",
            accuracy=2.0,
        )


def test_a_faint_channel_asks_for_a_smaller_error() -> None:
    """A thousandth of its level; channels that are rounding ask for nothing."""
    frf = measured(plate(), 0.0)
    level = np.sqrt(np.mean(np.abs(frf.values) ** 2, axis=0))
    values = frf.values / level
    for faintest, also, wanted in (
        (1.0, 1.0, 1e-5),
        (1e-4, 1.0, 1e-7),
        (1e-4, 1e-16, 1e-7),
        (1e-8, 0.0, 1e-9),
    ):
        values[:, 1] = faintest * frf.values[:, 1] / level[1]
        values[:, 2] = also * frf.values[:, 2] / level[2]
        data = updyn.FRF(frf.freq, values, frf.responses, frf.references, frf.quantity)
        part = FRFPart.build(plate(), data, updyn.parameters(plate(), stiffness="all"))
        (made,) = Reducing(Problem.of([part]), 1e-5)._parts
        assert made.reduction.accuracy == pytest.approx(wanted, rel=1e-9)


def test_a_stop_while_the_model_is_proved_keeps_the_values() -> None:
    model = plate()
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    found = updyn.update(
        model,
        measured(model, 0.01),
        unknowns,
        tier="reduced",
        backend="superlu",
        starts=0,
        callback=lambda progress: progress.stage == "reduce",
    )
    assert found.status == "stopped"
    best = min((h for h in found.history if h.accepted), key=lambda h: h.cost)
    for p in unknowns:  # loss factors may have been below zero on the way
        if p.quantity == "stiffness":
            assert found.values[p.name] == pytest.approx(best.values[p.name], rel=0.01)
            assert abs(found.values[p.name] - p.start) > 0.05


def test_a_reduced_run_goes_on_to_the_same_answer(tmp_path: Path) -> None:
    model = plate()
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    options = {"tier": "reduced", "backend": "superlu", "checkpoint": tmp_path / "run.journal"}
    frf = measured(model, 0.01)
    full = updyn.update(model, frf, unknowns, **options)
    whole = options["checkpoint"].read_bytes()
    for share in (0.3, 0.8):
        options["checkpoint"].write_bytes(whole[: int(share * len(whole))])
        found = updyn.update(model, frf, unknowns, resume=True, **options)
        assert (found.status, found.values, found.std, found.history) == (
            full.status, full.values, full.std, full.history,
        )  # fmt: skip


def test_a_channel_of_rounding_does_not_undo_a_search() -> None:
    """Its log error is as large at the truth as anywhere; that of a stiffer model happens to be less."""
    true = plate()
    start = true.scaled({g: {"stiffness": 2.0} for g in true.groups})
    clean = updyn.response(true, BAND, SENSORS, SENSORS[:1])
    draw = np.random.default_rng(0).standard_normal((2, *clean.values.shape)) / np.sqrt(2.0)
    noise = draw[0] + 1j * draw[1]
    values = clean.values * (1.0 + 0.01 * noise)
    values[:, 3] = 1e-13 * np.abs(clean.values).max() * noise[:, 3]
    frf = updyn.FRF(BAND, values, SENSORS, SENSORS[:1], "receptance")
    unknowns = updyn.parameters(start, stiffness="all")
    problem = Problem.of([FRFPart.build(start, frf, unknowns)])
    reducing = Reducing(problem, 1e-5)
    reducing.begin()
    found = np.full(problem.n, -np.log(2.0))
    noises = [choose_noise(None, frf)]
    assert reducing._choose_start(reducing.with_reduced_models(problem), noises, found) is found


def tower() -> updyn.Model:
    """Bars in a lattice of seven by thirteen nodes, the lowest held, symmetric; three storeys."""
    wide, high, storeys = 7, 13, 3
    at = np.array([(x, y) for y in range(high) for x in range(wide)], dtype=float)
    n = 2 * wide * (high - 1)
    K, mass = np.zeros((storeys, n + 2 * wide, n + 2 * wide)), np.zeros((storeys, n + 2 * wide))
    for a, b in combinations(range(len(at)), 2):
        along = at[b] - at[a]
        if np.abs(along).max() > 1.0 or at[b, 1] == 0.0:
            continue
        i = [2 * a, 2 * a + 1, 2 * b, 2 * b + 1]
        ends = np.r_[-along, along] / (along @ along)
        storey = int(max(at[a, 1], at[b, 1]) - 1) * storeys // (high - 1)
        K[storey][np.ix_(i, i)] += 1e6 * np.outer(ends, ends)
        mass[storey][i] += 0.25
    groups = {
        f"storey {s + 1}": updyn.Group(
            K[s][2 * wide :, 2 * wide :],
            np.diag(mass[s][2 * wide :]),
            loss_factor=0.01 * (s + 1),
        )
        for s in range(storeys)
    }
    return updyn.Model.from_groups(groups, [f"{i + 1}:{d}" for i in range(n // 2) for d in "XY"])


@pytest.mark.parametrize(
    ("tier", "method"),
    [("reduced", "maximum-likelihood"), ("sparse", "maximum-likelihood"), ("sparse", "log")],
)
def test_what_symmetry_forbids_tells_nothing(tier: str, method: str) -> None:
    """A load upwards in the middle moves nothing there sideways but by rounding."""
    true = tower()
    middle = true.n_dofs // 2 - 3
    sideways, at = f"{middle}:X", [f"{middle}:Y", "61:X", "45:Y", "20:X", "33:X"]
    modes = updyn.modes(true, 8).frequency
    lines = np.linspace(0.5 * modes[0], modes[6], 60)
    clean = updyn.response(true, lines, [*at, sideways], at[:1])
    assert np.abs(clean.values[:, -1]).max() < 1e-10 * np.abs(clean.values).max()
    draw = np.random.default_rng(0).standard_normal((2, *clean.values.shape)) / np.sqrt(2.0)
    values = clean.values * (1.0 + 0.01 * (draw[0] + 1j * draw[1]))
    frf = updyn.FRF(lines, values, clean.responses, clean.references, "receptance")
    start = true.scaled({g: {"stiffness": 1.2} for g in true.groups})
    unknowns = updyn.parameters(start, stiffness="all", loss_factor="all")
    heard = frf.select(responses=at)
    without = updyn.update(start, heard, unknowns, method, tier="sparse", starts=0)
    found = updyn.update(start, frf, unknowns, method, tier=tier, starts=0)
    assert (found.status, without.status) == ("converged", "converged")
    for name in unknowns.names:
        assert abs(found.values[name] - without.values[name]) < 1e-2 * without.std[name]
        assert found.std[name] == pytest.approx(without.std[name], rel=1e-2)
    assert found.message == without.message
    assert found.options["rounding"] == [f"{sideways} / {at[0]}"]
