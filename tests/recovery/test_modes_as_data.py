"""Updates to measured modes: what they recover, how sure they are, beside FRFs, held-out modes, what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

import updyn
from updyn.errors import DataError, DofError, OptionError, ParameterError
from updyn.modal import ModeSet
from updyn.model import Group, Model
from updyn.updating.update import identifiability, joint_identifiability

NOISE = {"frequency": 1e-3, "shape": 0.02, "loss_factor": 0.05}


def springs(factors: list[float], loss: list[float] | None = None) -> Model:
    """Masses of 2 kg on springs of 5 kN/m, held at one end, each spring a group."""
    n = len(factors)
    groups = {"masses": Group(mass=2.0 * np.eye(n))}
    for i, factor in enumerate(factors):
        K = np.zeros((n, n))
        K[i, i] = 5e3 * factor
        if i:
            K[i - 1, i - 1], K[i, i - 1], K[i - 1, i] = 5e3 * factor, -5e3 * factor, -5e3 * factor
        groups[f"spring {i + 1}"] = Group(K, loss_factor=0.01 if loss is None else loss[i])
    return Model.from_groups(groups, [f"{i + 1}:X" for i in range(n)])


TRUE = [1.3, 0.8, 1.1, 0.7, 1.2]
LOSS = [0.01, 0.02, 0.03, 0.005, 0.015]


def modes_of(model: Model, n: int, *, seed: int | None = None, stated: bool = False) -> ModeSet:
    """The lowest modes by LAPACK, loss factors by the energy lost; with noise, of any scale and sign."""
    value, shapes = scipy.linalg.eigh(model.stiffness.toarray(), model.mass.toarray())
    lost = sum(
        g.loss_factor * g.stiffness for g in model.groups.values() if g.stiffness is not None
    )
    loss = np.einsum("in,in->n", shapes, lost @ shapes)[:n] / value[:n]
    frequency, shapes = np.sqrt(value[:n]) / (2 * np.pi), shapes[:, :n]
    rms = np.sqrt(np.mean(shapes**2, axis=0))
    if seed is not None:
        rng = np.random.default_rng(seed)
        frequency = frequency * (1.0 + NOISE["frequency"] * rng.standard_normal(n))
        loss = loss * (1.0 + NOISE["loss_factor"] * rng.standard_normal(n))
        shapes = shapes + NOISE["shape"] * rms * rng.standard_normal(shapes.shape)
        shapes = shapes * rng.choice([-4.0, 4.0], n)
        rms = 4.0 * rms
    known = {}
    if stated:
        known = {
            "std_frequency": NOISE["frequency"] * frequency,
            "std_loss_factor": NOISE["loss_factor"] * loss,
            "std_shapes": NOISE["shape"] * np.broadcast_to(rms, shapes.shape),
        }
    return ModeSet(frequency, shapes, model.dofs, loss_factor=loss, source="by hand", **known)


def vector(result: updyn.UpdateResult) -> np.ndarray:
    return np.array([result.values[n] for n in result.parameters.names])


# -- what they recover -----------------------------------------------------------------------------------------------
def test_stiffness_and_damping_from_exact_modes() -> None:
    true, start = springs(TRUE, LOSS), springs([1.0] * 5)
    unknowns = updyn.parameters(start, stiffness="all", loss_factor="all")
    result = updyn.update(start, modes_of(true, 5), unknowns)
    assert result.ok
    expected = [LOSS[int(p.group[-1]) - 1] if p.quantity == "loss_factor" else TRUE[int(p.group[-1]) - 1]
                for p in unknowns]  # fmt: skip
    assert vector(result) == pytest.approx(expected, rel=1e-6)
    assert result.correlation["after"]["modes_paired"] == 5
    assert result.correlation["after"]["mac_min"] == pytest.approx(1.0)
    assert result.trust["plausible"]
    assert isinstance(result.data, ModeSet)
    with pytest.raises(OptionError, match="update to modes: it has no FRFs"):
        _ = result.frf
    text = result.summary()
    assert "FRF" not in text
    assert "frequency, rms error of pairs (%)" in text


@pytest.mark.parametrize("stated", [True, False])
def test_standard_deviations_are_those_of_the_estimates(stated: bool) -> None:
    true, start = springs(TRUE), springs([1.0] * 5)
    unknowns = updyn.parameters(start, stiffness="all")
    scores = []
    for seed in range(12):
        result = updyn.update(
            start, modes_of(true, 4, seed=seed, stated=stated), unknowns, starts=0
        )
        assert result.status == "converged"
        scores.append((vector(result) - TRUE) / np.array(list(result.std.values())))
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.3)


def test_weights_follow_what_is_left() -> None:
    """Frequencies to 0.1 %, shapes to 2 %: nearer to the frequencies than a fit that takes both as alike."""
    true, start = springs(TRUE), springs([1.0] * 5)
    unknowns = updyn.parameters(start, stiffness="all")
    modes = modes_of(true, 4, seed=3)
    result = updyn.update(start, modes, unknowns, starts=0)
    fixed = updyn.update(start, modes, unknowns, method="modal", shape_weight=1.0)
    far, near = (one.correlation["after"]["frequency_error_rms"] for one in (fixed, result))
    assert near < far
    assert near < 0.3
    assert result.noise["kind"] == "estimated"
    assert result.noise["shape"] == pytest.approx(0.02, rel=0.5)


def test_a_prior_and_regularisation_hold_what_modes_leave_open() -> None:
    """Stiffness and mass by one factor change no mode."""
    true, start = springs(TRUE), springs([1.0] * 5)
    modes = modes_of(true, 4, seed=1)
    unknowns = updyn.parameters(start, stiffness="all", mass="all")
    open_ = updyn.update(start, modes, unknowns, starts=0)
    assert open_.status == "not-identifiable"
    assert open_.identifiability.rank == 5
    assert "Modes show stiffness and mass against each other" in open_.remedy
    held = updyn.parameters(start, stiffness="all", mass="all", prior_std={"mass": 0.01})
    result = updyn.update(start, modes, held, starts=0)
    assert result.values["masses.mass"] == pytest.approx(1.0, abs=1e-3)
    assert result.std["masses.mass"] == pytest.approx(0.01, rel=0.05)
    pulled = updyn.update(start, modes, unknowns, starts=0, regularise=1.0)
    assert all(np.isfinite(s) for s in pulled.std.values())
    assert abs(np.log(pulled.values["masses.mass"])) < 0.5


@pytest.mark.parametrize("how", ["gcv", "tsvd"])
def test_a_chosen_strength_counts_the_numbers_of_modes(how: str) -> None:
    """Four modes at all sensors determine five stiffnesses: there is next to nothing to hold."""
    true, start = springs(TRUE), springs([1.0] * 5)
    unknowns = updyn.parameters(start, stiffness="all")
    modes = modes_of(true, 4, seed=1)
    free = updyn.update(start, modes, unknowns, starts=0)
    held = updyn.update(start, modes, unknowns, starts=0, regularise=how)
    for name, std in free.std.items():
        assert abs(held.values[name] - free.values[name]) < std


def test_modes_that_change_places_are_paired_by_shape() -> None:
    """At the start the modes in X lie below those in Y, in the test above them."""

    def plane(x: float, y: float) -> Model:
        groups = {}
        for name, at, factor in (("in x", [0, 1, 2], x), ("in y", [3, 4, 5], y)):
            K, M = np.zeros((6, 6)), np.zeros((6, 6))
            K[np.ix_(at, at)] = (
                1e4 * factor * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
            )
            M[np.ix_(at, at)] = np.eye(3)
            groups[name] = Group(K, M, loss_factor=0.01)
        return Model.from_groups(groups, [f"{i}:{d}" for d in "XY" for i in (1, 2, 3)])

    true, start = plane(1.3, 0.8), plane(0.9, 1.2)
    result = updyn.update(start, modes_of(true, 6), updyn.parameters(start, stiffness="all"))
    assert vector(result) == pytest.approx([1.3 / 0.9, 0.8 / 1.2], rel=1e-6)


def test_a_mode_that_the_model_lacks_is_left_out_and_said() -> None:
    true, start = springs(TRUE), springs([1.0] * 5)
    modes = modes_of(true, 4)
    stray = np.array([1.0, -1.0, 0.5, 1.0, -1.0])
    both = ModeSet([*modes.frequency, 9.0], np.column_stack([modes.shapes, stray]), modes.dofs)
    result = updyn.update(start, both, updyn.parameters(start, stiffness="all"))
    assert vector(result) == pytest.approx(TRUE, rel=1e-6)
    assert result.noise["left_out"] == "9 Hz"
    assert "omitted: 9 Hz" in result.remedy
    assert result.trust["plausible"].why.startswith("4 of 5 measured modes")


def test_the_method_of_fixed_weights_takes_modes_too() -> None:
    true, start = springs(TRUE), springs([1.0] * 5)
    unknowns = updyn.parameters(start, stiffness="all")
    result = updyn.update(start, modes_of(true, 4), unknowns, method="modal")
    assert vector(result) == pytest.approx(TRUE, rel=1e-8)
    assert result.noise["modes"] == 4
    by_mac = updyn.update(start, modes_of(true, 5), unknowns, method="modal", mac_residual=True)
    assert vector(by_mac) == pytest.approx(TRUE, rel=1e-6)
    with pytest.raises(ParameterError, match="real modes show neither damping"):
        updyn.update(
            start,
            modes_of(true, 4),
            updyn.parameters(start, stiffness="all", loss_factor="all"),
            method="modal",
        )


# -- beside FRFs -----------------------------------------------------------------------------------------------------
def test_information_of_frfs_and_modes_adds() -> None:
    """The inverse covariances of the two, each alone, add to that of both: the sum of log-likelihoods."""
    true, start = springs(TRUE, LOSS), springs(TRUE, LOSS)
    unknowns = updyn.parameters(start, stiffness="all")
    frf = updyn.response(true, np.linspace(1.0, 17.0, 60), ["5:X", "2:X"], ["5:X"], "accelerance")
    of_frfs = updyn.Test(start, frf, "frfs", noise={"relative": 0.3})
    of_modes = updyn.Test(
        start,
        modes_of(true, 3),
        "modes",
        noise={"frequency": 0.02, "shape": 0.2, "loss_factor": 0.2},
    )
    found = [
        np.linalg.solve(
            updyn.update_jointly(tests, unknowns, starts=0).first.covariance, np.eye(len(unknowns))
        )
        for tests in ([of_frfs], [of_modes], [of_frfs, of_modes], [of_modes, of_frfs])
    ]
    np.testing.assert_allclose(found[2], found[0] + found[1], rtol=1e-3)
    np.testing.assert_allclose(found[3], found[2], rtol=1e-6)


def test_modes_determine_what_frfs_leave_open() -> None:
    """FRFs of a few low lines, and modes at other sensors; each alone leaves directions open."""
    true, start = springs(TRUE, LOSS), springs([1.0] * 5)
    unknowns = updyn.parameters(start, stiffness="all", loss_factor="all")
    frf = updyn.response(true, [2.0, 2.4], ["5:X"], ["5:X"])
    modes = modes_of(true, 2)
    alone = [identifiability(start, data, unknowns).rank for data in (frf, modes)]
    assert max(alone) < len(unknowns)
    tests = [updyn.Test(start, modes_of(true, 5), "modes"), updyn.Test(start, frf, "frfs")]
    assert joint_identifiability(tests, unknowns).rank == len(unknowns)
    result = updyn.update_jointly(tests, unknowns)
    assert result.status == "converged"
    assert list(result.results) == ["modes", "frfs"]
    assert isinstance(result["modes"].data, ModeSet)
    assert result["frfs"].lines == pytest.approx([2.0, 2.4])
    assert result["modes"].correlation["after"]["frequency_error_rms"] < 1e-4
    expected = [LOSS[int(p.group[-1]) - 1] if p.quantity == "loss_factor" else TRUE[int(p.group[-1]) - 1]
                for p in unknowns]  # fmt: skip
    assert vector(result.first) == pytest.approx(expected, rel=1e-4)
    assert "modes, paired" in result.summary()


# -- what is held out, kept and shown --------------------------------------------------------------------------------
def test_held_out_modes_are_predicted() -> None:
    true, start = springs(TRUE), springs([1.0] * 5)
    modes = modes_of(true, 5, seed=2)
    unknowns = updyn.parameters(start, stiffness="all")
    result = updyn.update(start, modes, unknowns, validation=(14.0, 20.0), starts=0)
    held = result.correlation["validation"]["after"]
    assert held["modes_measured"] == 1
    assert result.correlation["after"]["modes_measured"] == 4
    assert held["frequency_error_rms"] < 1.0
    assert result.trust["validated"]
    # Of another structure: the mode is somewhere else.
    shifted = replace_frequency(modes, 4, 1.2)
    wrong = updyn.update(start, shifted, unknowns, validation=(14.0, 20.0), starts=0)
    assert not wrong.trust["validated"]
    assert wrong.status == "not-credible"


def replace_frequency(modes: ModeSet, which: int, factor: float) -> ModeSet:
    frequency = modes.frequency.copy()
    frequency[which] *= factor
    return ModeSet(frequency, modes.shapes, modes.dofs, loss_factor=modes.loss_factor)


def test_a_structure_that_is_not_the_model_is_not_believed() -> None:
    """One unknown for all: frequencies are off by a quarter and more, wherever it ends."""
    true, start = springs([4.0, 0.3, 4.0, 0.3, 4.0]), springs([1.0] * 5)
    result = updyn.update(start, modes_of(true, 5), updyn.parameters(start, stiffness=["spring 1"]))
    assert result.status == "not-credible"
    assert result.trust["plausible"].holds is False


def test_record_and_report(tmp_path: Path) -> None:
    true, start = springs(TRUE, LOSS), springs([1.0] * 5)
    modes = modes_of(true, 5, seed=4, stated=True)
    unknowns = updyn.parameters(start, stiffness="all", loss_factor="all")
    result = updyn.update(start, modes, unknowns, starts=0, title="Springs")
    updyn.write_result(result, tmp_path / "run.nc")
    back = updyn.read_result(tmp_path / "run.nc")
    assert isinstance(back.data, ModeSet)
    for name in ("frequency", "shapes", "loss_factor", "std_frequency", "std_shapes", "scaled"):
        np.testing.assert_array_equal(getattr(back.data, name), getattr(modes, name))
    assert back.data.digest == modes.digest
    assert back.data.source == "by hand"
    assert back.values == result.values
    page = updyn.write_report(replace(back, title="Springs"), tmp_path / "report.html")
    text = page.read_text(encoding="utf-8")
    assert "5 modes at 5 DOFs" in text
    assert "Frequency error, rms" in text
    assert 'id="frfs"' not in text
    assert 'id="modes"' in text


def test_a_stopped_run_goes_on_to_the_same_answer(tmp_path: Path) -> None:
    true, start = springs(TRUE), springs([1.0] * 5)
    modes, unknowns = (
        modes_of(true, 4, seed=5),
        updyn.parameters(springs([1.0] * 5), stiffness="all"),
    )
    whole = updyn.update(start, modes, unknowns)
    calls = 0

    def stop(progress: object) -> bool:
        nonlocal calls
        calls += 1
        return calls > 6

    path = tmp_path / "run.journal"
    stopped = updyn.update(start, modes, unknowns, callback=stop, checkpoint=path)
    assert stopped.status == "stopped"
    resumed = updyn.update(start, modes, unknowns, checkpoint=path, resume=True)
    assert resumed.values == whole.values
    assert resumed.iterations == whole.iterations
    other = modes_of(true, 4, seed=6)
    with pytest.raises(OptionError, match="data"):
        updyn.update(start, other, unknowns, checkpoint=path, resume=True)


def test_unknowns_are_selected_by_modes() -> None:
    """Springs in a row at one end are seen by the low modes together."""
    start = springs([1.0] * 5)
    unknowns = updyn.parameters(start, stiffness="all", mass="all")
    test = updyn.Test(start, modes_of(springs(TRUE), 3))
    chosen = updyn.select_jointly([test], unknowns, 3)
    assert len(chosen.parameters) == 3


# -- what is refused -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"lines": [1.0]}, OptionError, "lines: modes have none"),
        ({"method": "log"}, OptionError, "'log' fits FRFs, not modes; use 'maximum-likelihood' or 'modal'"),
        ({"noise": {"relative": 0.1}}, OptionError, "noise: no key 'relative' for modes"),
        ({"validation": ["1:X"]}, DataError, "of modes, a band of two frequencies"),
        ({"validation": "1:X"}, DataError, "validation '1:X': expected two frequencies in Hz"),
        ({"validation": (0.1, 0.2)}, DataError, "no measured mode lies in it"),
        ({"validation": (0.0, 1e3)}, DataError, "no measured mode lies outside it"),
        ({"tier": "dense"}, OptionError, "tier 'dense': modes are computed with 'sparse' or 'reduced'"),
        ({"tier": "fast"}, OptionError, "tier 'fast'"),
        ({"backend": "superlu"}, OptionError, "backend: modes of a full model .* are computed by one way"),
    ],
)  # fmt: skip
def test_options_that_do_not_fit_modes(
    options: dict[str, object], error: type[Exception], message: str
) -> None:
    start = springs([1.0] * 5)
    with pytest.raises(error, match=message):
        updyn.update(start, modes_of(start, 4), updyn.parameters(start, stiffness="all"), **options)


def test_modes_that_do_not_fit_the_model() -> None:
    start = springs([1.0] * 5)
    unknowns = updyn.parameters(start, stiffness="all")
    with pytest.raises(DofError, match="DOF of the modes 9:X"):
        updyn.update(start, ModeSet([3.0], [[1.0]], ["9:X"]), unknowns)
    with pytest.raises(DataError, match="a measured mode at 0 Hz"):
        updyn.update(start, ModeSet([0.0], [[1.0]], ["5:X"]), unknowns)
    mixed = ModeSet([3.0], modes_of(start, 5).shapes.sum(axis=1, keepdims=True), start.dofs)
    with pytest.raises(DataError, match="no measured mode resembles a mode of the model"):
        updyn.update(start, mixed, unknowns)
    with pytest.raises(OptionError, match="expected a FRF or ModeSet, found str"):
        updyn.update(start, "modes.unv", unknowns)
