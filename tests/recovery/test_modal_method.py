"""Modal sensitivity: what it recovers from exact modes, what it cannot see, pairing, spread, what it refuses."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.linalg

import updyn
from places import DATA
from updyn.errors import DataError, DofError, OptionError, ParameterError
from updyn.frf import FRF
from updyn.modal import ModeSet
from updyn.model import Model

CASE = json.loads((DATA / "cases" / "iasc_asce.json").read_text(encoding="utf-8"))
SENSORS = ["2:X", "5:X", "7:X", "10:X", "12:X"]


def modes_of(model: Model, n: int, dofs: list[str]) -> ModeSet:
    """The lowest undamped modes as a test would give them; by LAPACK, not by the solver of the method."""
    value, shapes = scipy.linalg.eigh(model.stiffness.toarray(), model.mass.toarray())
    at = model.dofs.match(dofs)
    seen = shapes[at.index, :n] * at.sign[:, None]
    return ModeSet(np.sqrt(value[:n]) / (2 * np.pi), seen, dofs)


def vector(result: updyn.UpdateResult) -> np.ndarray:
    return np.array([result.values[n] for n in result.parameters.names])


def some_frf(model: Model, dofs: list[str]) -> FRF:
    return updyn.response(model, np.linspace(0.5, 24.0, 60), dofs, dofs[-1:], "accelerance")


def springs(factors: list[float]) -> Model:
    """Masses of 2 kg on springs of 5 kN/m, held at one end, each spring a group."""
    n = len(factors)
    groups = {"masses": updyn.Group(mass=2.0 * np.eye(n))}
    for i, factor in enumerate(factors):
        K = np.zeros((n, n))
        K[i, i] = 5e3 * factor
        if i:
            K[i - 1, i - 1], K[i, i - 1], K[i - 1, i] = 5e3 * factor, -5e3 * factor, -5e3 * factor
        groups[f"spring {i + 1}"] = updyn.Group(K, loss_factor=0.01)
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


# -- what it recovers ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shapes", [False, True])
def test_three_springs_from_three_modes(shapes: bool) -> None:
    true, start = springs([1.3, 0.8, 1.1]), springs([1.0, 1.0, 1.0])
    dofs = list(start.dofs.labels)
    unknowns = updyn.parameters(start, stiffness="all")
    result = updyn.update(
        start,
        some_frf(true, dofs),
        unknowns,
        method="modal",
        modes=modes_of(true, 3, dofs),
        shapes=shapes,
    )
    assert result.status == "converged"
    assert vector(result) == pytest.approx([1.3, 0.8, 1.1], rel=1e-9)
    assert result.noise["modes"] == 3
    assert result.noise["frequency_rms"] < 1e-10


def test_stiffness_and_mass_from_the_frfs(chain12: Model, chain12_case: dict[str, Any]) -> None:
    """Modes identified from the FRFs of a chain of one loss factor; one mass has to be known."""
    true = chain12_case["true_factors"]
    changes = {
        f"part{g + 1}": {"stiffness": true["stiffness"][g], "mass": true["mass"][g]}
        for g in range(4)
    }
    loss = {f"part{g}": {"loss_factor": 0.03} for g in range(1, 5)}
    start = chain12.scaled({**loss, "part1": {"mass": true["mass"][0], "loss_factor": 0.03}})
    tested = chain12.scaled({p: {**changes[p], **loss[p]} for p in changes})
    frf = updyn.response(
        tested, np.linspace(0.5, 23.0, 160), SENSORS, ["2:X", "12:X"], "accelerance"
    )
    unknowns = updyn.parameters(start, stiffness="all", mass=["part2", "part3", "part4"])
    result = updyn.update(start, frf, unknowns, method="modal")
    assert result.status == "converged"
    expected = [changes[p.group][p.quantity] for p in unknowns]
    assert vector(result) == pytest.approx(expected, rel=1e-7)


def test_what_scales_together_is_said_to_be_open(chain12: Model, chain12_true: Model) -> None:
    """All stiffness and all mass by one factor change no mode; their ratios are found."""
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all")
    modes = modes_of(chain12_true, 6, SENSORS)
    result = updyn.update(
        chain12, some_frf(chain12_true, SENSORS), unknowns, method="modal", modes=modes
    )
    assert result.status == "not-identifiable"
    assert result.identifiability.rank == len(unknowns) - 1
    (direction,) = result.identifiability.null_directions
    assert set(direction) == set(unknowns.names)
    assert np.array(list(direction.values())) == pytest.approx(np.ones(8), abs=1e-6)
    assert all(np.isinf(s) for s in result.std.values())
    assert result.remedy.startswith(
        "Modes show stiffness and mass against each other"
    )  # no line would help
    assert result.identifiability.advice == result.remedy
    true = [abs(getattr(chain12_true.group(p.group), p.quantity)).sum() for p in unknowns]
    first = [abs(getattr(chain12.group(p.group), p.quantity)).sum() for p in unknowns]
    ratio = vector(result) * first / true
    assert ratio / ratio[0] == pytest.approx(np.ones(8), rel=1e-7)


def test_missing_braces_from_printed_frequencies() -> None:
    """IASC-ASCE, damage pattern 1: storey stiffness from the frequencies of the table, two decimals.

    Johnson, Lam, Katafygiotis & Beck, J. Eng. Mech. 130 (2004) 3. Shapes, for the pairing alone,
    are the start's."""
    storey = {"x": "x_N_m", "y": "y_N_m"}
    for d, key in storey.items():
        groups = {}
        for i in range(4):
            K = np.zeros((4, 4))
            K[i, i] = 1.0
            if i:
                K[i - 1, i - 1], K[i, i - 1], K[i - 1, i] = 1.0, -1.0, -1.0
            groups[f"storey {i + 1}"] = updyn.Group(
                CASE["storey_stiffness"][key] * K, loss_factor=0.02
            )
            groups[f"floor {i + 1}"] = updyn.Group(mass=np.diag(np.eye(4)[i]) * CASE["mass_kg"][i])
        start = updyn.Model.from_groups(groups, [f"{i}:X" for i in range(1, 5)])
        pattern = CASE["damage_1_no_braces_in_storey_1"]
        modes = ModeSet(
            pattern["frequencies_hz"][d],
            modes_of(start, 4, start.dofs.labels).shapes,
            start.dofs.labels,
        )
        unknowns = updyn.parameters(start, stiffness="all")
        frf = some_frf(start, start.dofs.labels)
        found = updyn.update(start, frf, unknowns, method="modal", modes=modes, shapes=False).values
        damaged = pattern[f"storey_1_{d}_N_m"] / CASE["storey_stiffness"][key]
        assert found["storey 1.stiffness"] == pytest.approx(damaged, rel=0.01)
        for i in (2, 3, 4):
            assert found[f"storey {i}.stiffness"] == pytest.approx(1.0, abs=0.01)


def plane(x: float, y: float) -> Model:
    """The same chain in X and in Y, each with a factor on its stiffness."""
    groups = {}
    for name, at, factor in (("in x", [0, 1, 2], x), ("in y", [3, 4, 5], y)):
        K, M = np.zeros((6, 6)), np.zeros((6, 6))
        K[np.ix_(at, at)] = (
            1e4 * factor * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
        )
        M[np.ix_(at, at)] = np.eye(3)
        groups[name] = updyn.Group(K, M, loss_factor=0.01)
    return updyn.Model.from_groups(groups, [f"{i}:{d}" for d in "XY" for i in (1, 2, 3)])


def test_modes_are_paired_by_shape_not_by_number() -> None:
    """At the start the modes in X lie below those in Y, in the test above them."""
    true, start = plane(1.3, 0.8), plane(0.9, 1.2)
    dofs = start.dofs.labels
    result = updyn.update(
        start,
        some_frf(true, dofs),
        updyn.parameters(start, stiffness="all"),
        method="modal",
        modes=modes_of(true, 6, dofs),
    )
    assert result.status == "converged"
    assert vector(result) == pytest.approx([1.3 / 0.9, 0.8 / 1.2], rel=1e-9)


def test_coinciding_modes_that_no_unknown_couples_are_fitted() -> None:
    """At the start the modes in both planes coincide, and what the solver gives is any mixture of them."""
    true, start = plane(1.3, 0.8), plane(1.0, 1.0)
    dofs = start.dofs.labels
    unknowns = updyn.parameters(start, stiffness="all")
    result = updyn.update(
        start, some_frf(true, dofs), unknowns, method="modal", modes=modes_of(true, 6, dofs)
    )
    assert result.status == "converged"
    assert vector(result) == pytest.approx([1.3, 0.8], rel=1e-9)


def test_coinciding_modes_that_unknowns_couple_are_refused() -> None:
    """Springs in X and at 45 degrees, of a start that is alike in all directions."""
    across = np.zeros((2, 6, 6))
    for k, sign in enumerate((1.0, -1.0)):
        across[k, [0, 0, 3, 3], [0, 3, 0, 3]] = 5e3 * np.array([1.0, sign, sign, 1.0])
    slant = {name: updyn.Group(K) for name, K in zip(("slant", "other"), across, strict=True)}
    start = updyn.Model.from_groups({**plane(1.0, 1.0).groups, **slant}, plane(1.0, 1.0).dofs)
    true = start.scaled({"in x": {"stiffness": 1.2}, "slant": {"stiffness": 1.5}})
    dofs, unknowns = start.dofs.labels, updyn.parameters(start, stiffness=["in x", "slant"])
    result = updyn.update(
        start,
        some_frf(true, dofs),
        unknowns,
        method="modal",
        modes=modes_of(true, 6, dofs),
        mac=0.0,
    )
    assert result.status == "failed"
    assert "2 modes of the model coincide at 8.238" in result.message
    assert vector(result) == pytest.approx([1.0, 1.0])
    apart = unknowns.with_start(
        {"slant.stiffness": 1.1}
    )  # the symmetry broken, as the message says
    result = updyn.update(
        start, some_frf(true, dofs), apart, method="modal", modes=modes_of(true, 6, dofs), mac=0.0
    )
    assert vector(result) == pytest.approx([1.2, 1.5], rel=1e-7)


def test_modes_that_resemble_the_model_only_later_join_later() -> None:
    """A square membrane whose halves differ: from the symmetric start some pairs are mixtures of the measured modes."""
    n = 12
    number = np.arange(n * n).reshape(n, n)
    pairs = np.array([*zip(number[:, :-1].ravel(), number[:, 1:].ravel(), strict=True),
                      *zip(number[:-1].ravel(), number[1:].ravel(), strict=True)])  # fmt: skip
    groups = {}
    for name, own in (("left", pairs[:, 0] % n < n // 2), ("right", pairs[:, 0] % n >= n // 2)):
        B = np.zeros((own.sum(), n * n))
        B[np.arange(len(B)), pairs[own, 0]], B[np.arange(len(B)), pairs[own, 1]] = 1.0, -1.0
        groups[name] = updyn.Group(1e4 * B.T @ B, loss_factor=0.01)
    held = np.zeros((n, n))
    held[[0, -1]] = held[:, [0, -1]] = 1e4
    groups["frame"] = updyn.Group(np.diag(held.ravel()), np.eye(n * n))
    start = updyn.Model.from_groups(groups, [f"{i + 1}:Z" for i in range(n * n)])
    true = start.scaled({"left": {"stiffness": 1.2}, "right": {"stiffness": 0.9}})
    sensors = [
        f"{i + 1}:Z" for i in np.sort(np.random.default_rng(0).choice(n * n, 16, replace=False))
    ]
    frf = updyn.response(true, np.linspace(1.0, 2.0, 5), sensors, sensors[:1], "accelerance")
    unknowns = updyn.parameters(start, stiffness="all")
    modes = modes_of(true, 10, sensors)
    result = updyn.update(start, frf, unknowns, method="modal", modes=modes)
    assert result.status == "converged"
    assert vector(result) == pytest.approx([1.2, 0.9, 1.0], rel=1e-8)
    assert result.noise["modes"] == 10
    at_first = updyn.update(start, frf, unknowns, method="modal", modes=modes, max_iterations=0)
    assert at_first.noise["modes"] < 10
    assert at_first.noise["left_out"].endswith(" Hz")


def test_a_measured_mode_that_resembles_none_is_left_out(
    chain12: Model, chain12_true: Model
) -> None:
    modes = modes_of(chain12_true, 5, SENSORS)
    stray = np.random.default_rng(5).standard_normal(5)
    shapes = np.column_stack([modes.shapes, stray])
    with_stray = ModeSet([*modes.frequency, 13.0], shapes, SENSORS)
    unknowns = updyn.parameters(chain12, stiffness="all")
    known = chain12.scaled({g: {"mass": _mass(chain12_true, chain12, g)} for g in chain12.groups})
    frf = some_frf(chain12_true, SENSORS)
    clean, result = (
        updyn.update(known, frf, unknowns, method="modal", modes=m, mac=0.8)
        for m in (modes, with_stray)
    )
    assert result.noise["modes"] == 5
    assert "omitted: 13 Hz" in result.remedy
    assert result.noise["left_out"] == "13 Hz"
    assert vector(result) == pytest.approx(vector(clean), rel=1e-9)


def _mass(true: Model, start: Model, group: str) -> float:
    return float(abs(true.group(group).mass).sum() / abs(start.group(group).mass).sum())


def test_several_tests_with_modes_by_name() -> None:
    """The chain held at one end, and with a known mass added at the other."""
    true, start = springs([1.3, 0.8, 1.1]), springs([1.0, 1.0, 1.0])
    dofs = start.dofs.labels
    heavy = [
        updyn.Model.from_groups({**m.groups, "added": updyn.Group(mass=np.diag([0, 0, 1.0]))}, dofs)
        for m in (true, start)
    ]
    tests = [
        updyn.Test(start, some_frf(true, dofs), "bare"),
        updyn.Test(heavy[1], some_frf(heavy[0], dofs), "heavy"),
    ]
    unknowns = updyn.parameters(start, stiffness="all", mass="all")
    modes = {"bare": modes_of(true, 3, dofs), "heavy": modes_of(heavy[0], 3, dofs)}
    result = updyn.update_jointly(tests, unknowns, method="modal", modes=modes, shapes=False)
    found = result.results["bare"]
    assert (
        found.status == "converged"
    )  # what was added is known: it gives the scale of mass and stiffness
    assert vector(found) == pytest.approx([1.0, 1.3, 0.8, 1.1], rel=1e-8)
    # A test none of whose modes is like one of the model adds nothing.
    mixture = modes["bare"].shapes.sum(axis=1, keepdims=True)
    odd = {**modes, "bare": ModeSet([9.0], mixture, dofs)}
    stiffness = updyn.parameters(start, stiffness="all")
    both = updyn.update_jointly(tests, stiffness, method="modal", modes=odd, mac=0.9).results
    assert vector(both["heavy"]) == pytest.approx([1.3, 0.8, 1.1], rel=1e-8)
    assert both["bare"].noise["left_out"] == "9 Hz"
    assert "left_out" not in both["heavy"].noise
    with pytest.raises(OptionError, match="there are several tests"):
        updyn.update_jointly(tests, unknowns, method="modal", modes=modes["bare"])
    with pytest.raises(OptionError, match="no test 'bear'; did you mean 'bare'"):
        updyn.update_jointly(tests, unknowns, method="modal", modes={"bear": modes["bare"]})


# -- how sure it is --------------------------------------------------------------------------------------------------
def test_standard_deviations_are_those_of_the_estimates(
    chain12: Model, chain12_true: Model
) -> None:
    """Frequencies to 0.1 %, shapes to 1 %, the ratio that the weights take for granted; 25 draws."""
    known = chain12.scaled({g: {"mass": _mass(chain12_true, chain12, g)} for g in chain12.groups})
    unknowns = updyn.parameters(known, stiffness="all")
    exact = modes_of(chain12_true, 6, SENSORS)
    few = some_frf(chain12_true, SENSORS).band(2.0, 4.0)  # too few lines to look for causes in
    rms = np.sqrt(np.mean(np.abs(exact.shapes) ** 2, axis=0))
    rng, truth = (
        np.random.default_rng(11),
        np.array([_stiffness(chain12_true, chain12, g) for g in chain12.groups]),
    )
    scores = []
    for _ in range(25):
        shapes = exact.shapes + 0.01 * rms * rng.standard_normal(exact.shapes.shape)
        modes = ModeSet(exact.frequency * (1 + 1e-3 * rng.standard_normal(6)), shapes, SENSORS)
        result = updyn.update(known, few, unknowns, method="modal", modes=modes)
        assert result.status == "converged"
        scores.append((vector(result) - truth) / np.array(list(result.std.values())))
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.25)
    assert np.abs(np.mean(scores, axis=0)).max() < 0.6


def _stiffness(true: Model, start: Model, group: str) -> float:
    return float(abs(true.group(group).stiffness).sum() / abs(start.group(group).stiffness).sum())


@pytest.mark.usefixtures("no_causes")
def test_unit_of_length_does_not_matter(mixed_model: Callable[[float], Model]) -> None:
    dofs, fits = ["1:Y", "2:RZ", "3:Y", "4:RZ", "2:Y"], []
    for length in (1.0, 1e-3):
        start = mixed_model(length)
        true = start.scaled({"a": {"stiffness": 1.1}, "b": {"stiffness": 0.9, "mass": 1.05}})
        exact = modes_of(true, 4, dofs)
        noise = 1.0 + 0.01 * np.random.default_rng(2).standard_normal(exact.shapes.shape)
        sign = np.sign(exact.shapes[0])  # LAPACK may turn a shape
        modes = ModeSet(exact.frequency * 1.001, exact.shapes * sign * noise, dofs)
        frf = updyn.response(true, np.linspace(2, 60, 50), dofs, dofs[:1])
        unknowns = updyn.parameters(start, stiffness="all", mass=["b"])
        fits.append(updyn.update(start, frf, unknowns, method="modal", modes=modes))
    assert vector(fits[1]) == pytest.approx(vector(fits[0]), rel=1e-6)
    assert list(fits[1].std.values()) == pytest.approx(list(fits[0].std.values()), rel=1e-4)


def test_a_prior_holds_what_modes_leave_open(chain12: Model, chain12_true: Model) -> None:
    prior = {"mass": 0.1}
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", prior_std=prior)
    exact = modes_of(chain12_true, 6, SENSORS)
    modes = ModeSet(
        exact.frequency * (1 + 1e-3 * np.random.default_rng(1).standard_normal(6)),
        exact.shapes,
        SENSORS,
    )
    result = updyn.update(
        chain12, some_frf(chain12_true, SENSORS), unknowns, method="modal", modes=modes
    )
    # The four priors meet at one common factor: its deviation is that of their mean.
    assert all(np.isfinite(s) for s in result.std.values())
    assert result.std["part1.mass"] / result.values["part1.mass"] == pytest.approx(0.05, rel=0.05)
    masses = np.log([result.values[f"part{g}.mass"] for g in range(1, 5)])
    assert masses.mean() == pytest.approx(0.0, abs=1e-3)


# -- what it refuses -------------------------------------------------------------------------------------------------
def test_damping_is_refused_by_name(chain12: Model, chain12_frf: FRF) -> None:
    unknowns = updyn.parameters(chain12, stiffness="all", loss_factor=["part1", "part2"])
    with pytest.raises(
        ParameterError, match=r"show neither damping .*\(part1.loss_factor, part2.loss_factor\)"
    ):
        updyn.update(chain12, chain12_frf, unknowns, method="modal")


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"modes": "modes.unv"}, OptionError, "expected a ModeSet, found str; .*test. modes"),
        ({"shape_weight": 0.0}, OptionError, "shape_weight = 0: expected a number above 0"),
        ({"mac": 1.5}, OptionError, "mac = 1.5: expected a number from 0 to 1"),
        (
            {"modes": ModeSet([1.0], [[1.0]], ["99:X"])},
            DofError,
            "DOF of the modes 99:X is not among",
        ),
        ({"modes": ModeSet([0.0], [[1.0]], ["2:X"])}, DataError, "a measured mode at 0 Hz"),
        (
            {"modes": ModeSet(np.arange(1.0, 14.0), np.ones((1, 13)), ["2:X"])},
            DataError,
            "13 modes were measured; .* 12",
        ),
        ({"tier": "reduced"}, OptionError, "'modal' computes modes"),
    ],
)
def test_bad_options_are_refused(
    chain12: Model, chain12_frf: FRF, options: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        updyn.update(
            chain12,
            chain12_frf,
            updyn.parameters(chain12, stiffness="all"),
            method="modal",
            **options,
        )


def test_modes_that_resemble_nothing_are_refused(chain12: Model, chain12_frf: FRF) -> None:
    modes = ModeSet([30.0], [[1.0], [0.0], [0.0], [0.0], [0.0]], SENSORS)
    with pytest.raises(
        DataError,
        match="no measured mode resembles a mode of the model at its start: the largest MAC is 0",
    ):
        updyn.update(
            chain12,
            chain12_frf,
            updyn.parameters(chain12, stiffness="all"),
            method="modal",
            modes=modes,
            mac=0.9,
        )


# -- a run -----------------------------------------------------------------------------------------------------------
@pytest.mark.usefixtures("no_causes")
def test_stopped_limited_and_resumed_runs(
    chain12: Model, chain12_true: Model, tmp_path: Path
) -> None:
    modes, frf = modes_of(chain12_true, 6, SENSORS), some_frf(chain12_true, SENSORS)
    unknowns = updyn.parameters(chain12, stiffness="all", mass=["part2", "part3", "part4"])
    options: dict[str, Any] = {"method": "modal", "modes": modes}
    whole = updyn.update(chain12, frf, unknowns, **options)
    brief = updyn.update(
        chain12, frf, unknowns, max_iterations=2, checkpoint=tmp_path / "journal", **options
    )
    assert brief.status == "max-iterations"
    resumed = updyn.update(
        chain12, frf, unknowns, checkpoint=tmp_path / "journal", resume=True, **options
    )
    assert vector(resumed).tolist() == vector(whole).tolist()
    other = ModeSet(modes.frequency * 1.01, modes.shapes, modes.dofs)
    with pytest.raises(updyn.UpdynError, match="modes"):
        updyn.update(
            chain12,
            frf,
            unknowns,
            checkpoint=tmp_path / "journal",
            resume=True,
            **{**options, "modes": other},
        )
    stopped = updyn.update(
        chain12, frf, unknowns, callback=lambda p: len(p.stage) > 0 and p.iteration >= 1, **options
    )
    assert stopped.status == "stopped"


def test_the_record_keeps_the_modes(chain12: Model, chain12_true: Model, tmp_path: Path) -> None:
    modes, frf = modes_of(chain12_true, 6, SENSORS), some_frf(chain12_true, SENSORS)
    unknowns = updyn.parameters(chain12, stiffness="all")
    result = updyn.update(chain12, frf, unknowns, method="modal", modes=modes)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        updyn.write_result(result, tmp_path / "run.nc")
        again = updyn.read_result(tmp_path / "run.nc")
    assert again.options["modes"].digest == modes.digest
    assert again.options["modes"].source == modes.source
