"""Methods: names and options, the paper's iteration, agreement of methods on exact data, priors."""

import numpy as np
import pytest

import updyn
from updyn.demos.gear_train import starting_model, true_model
from updyn.errors import DataError, OptionError
from updyn.updating.fit.methods import METHODS, make_method, options_of

#: Those that take any data, unknowns and priors; the others have tests of their own.
GENERAL = ["maximum-likelihood", "log", "output-error", "equation-error"]
FOUR = [f"{i}:RZ" for i in range(1, 5)]
SETTINGS = {
    "8": [5, 10, 20, 30, 50, 75, 100, 150],
    "40 linear": np.linspace(5, 900, 40),
    "40 geometric": np.geomspace(5, 900, 40),
}


def gear_train_case(omega, reading):
    """Start, data, unknowns and true values of the unknowns, as factors on the start."""
    true, start = true_model(), starting_model(reading)
    unknowns = updyn.parameters(start, stiffness="all", mass="all", loss_factor="all")
    truth = np.array([
        true.group(p.group).loss_factor
        if p.quantity == "loss_factor"
        else abs(getattr(true.group(p.group), p.quantity)).sum() / abs(getattr(start.group(p.group), p.quantity)).sum()
        for p in unknowns
    ])  # fmt: skip
    return (
        start,
        updyn.response(true, np.array(omega) / (2 * np.pi), FOUR, ["2:RZ"]),
        unknowns,
        truth,
    )


def vector(result):
    return np.array([result.values[n] for n in result.parameters.names])


# -- names and options -----------------------------------------------------------------------------------------------
def test_every_method_takes_max_iterations_and_tolerance():
    for name in METHODS:
        assert {"max_iterations", "tolerance"} <= options_of(name).keys()
        assert make_method(name, {"max_iterations": 7, "tolerance": 1e-6}).max_iterations == 7


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("maximum-likelyhood", {}, r"method 'maximum-likelyhood': .*maximum-likelihood"),
        (
            "log",
            {"max_iteration": 3},
            r"method 'log' has no option 'max_iteration'; .*max_iterations",
        ),
        ("output-error", {"starts": 3}, r"method 'output-error' has no option 'starts'"),
        (
            "log",
            {"max_iterations": -1},
            r"option max_iterations = -1: expected a number of at least 0",
        ),
        ("log", {"max_iterations": 2.5}, r"option max_iterations = 2.5: expected int, such as"),
        ("log", {"max_iterations": True}, r"option max_iterations = True: expected int"),
        ("log", {"tolerance": "small"}, r"option tolerance = 'small': expected float"),
        (
            "log",
            {"tolerance": float("nan")},
            r"option tolerance = nan: expected a number of at least 0",
        ),
        ("equation-error", {"solver": "gauss"}, r"solver 'gauss': .*gauss-newton"),
        (
            "equation-error",
            {"solver": 3},
            r"option solver = 3: expected str, such as 'trust-region'",
        ),
    ],
)
def test_options_are_checked_by_name_and_kind(name, options, message):
    with pytest.raises(OptionError, match=message):
        make_method(name, options)


def test_whole_numbers_of_numpy_are_whole_numbers():
    assert (
        make_method(
            "log", {"max_iterations": np.int64(3), "tolerance": np.float64(1e-5)}
        ).max_iterations
        == 3
    )


# -- the paper's iteration -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("reading", [0, 1])
def test_plain_iteration_gives_the_papers_loss_factors_in_five_steps(reading):
    """Table 6: 0.4 and 0.6, the others zero; and 17 of 18 unknowns, which the paper does not say."""
    start, data, unknowns, truth = gear_train_case([10, 20, 50, 100], reading)
    result = updyn.update(
        start, data, unknowns, method="equation-error", solver="gauss-newton", max_iterations=5
    )
    assert result.status == "not-identifiable"
    loss = ~unknowns.is_factor
    assert vector(result)[loss] == pytest.approx(truth[loss], abs=1e-9)
    assert result.identifiability.rank == 17
    assert result.iterations <= 5
    opened = {
        "unit 1.mass",
        "unit 1.stiffness",
        "unit 5.mass",
        "unit 5.stiffness",
        "unit 6.mass",
        "unit 6.stiffness",
    }
    assert {n for n, s in result.std.items() if np.isinf(s)} == opened
    assert set(result.identifiability.null_directions[0]) == opened
    known = [i for i, n in enumerate(unknowns.names) if n not in opened]
    # The smallest singular value that is not zero, 1e-5, costs the stiffness of units 3 and 4 some
    # digits.
    assert vector(result)[known] == pytest.approx(truth[known], abs=1e-7)


@pytest.mark.parametrize("reading", [0, 1])
def test_open_unknowns_lie_on_the_family_that_fits(reading):
    """What is found fits the data exactly, and is the truth moved along the open direction only, to first order."""
    start, data, unknowns, truth = gear_train_case([10, 20, 50, 100], reading)
    result = updyn.update(start, data, unknowns, method="equation-error")
    assert result.status == "not-identifiable"
    refound = updyn.response(result.model, data.freq, data.responses, data.references).values
    assert refound == pytest.approx(data.values, rel=1e-8)
    (direction,) = result.identifiability.null_directions
    moved = np.log(vector(result)[unknowns.is_factor] / truth[unknowns.is_factor])
    names = [n for n, f in zip(unknowns.names, unknowns.is_factor, strict=True) if f]
    along = np.array([direction.get(n, 0.0) for n in names])
    share = moved @ along / (along @ along)
    assert abs(share) > 1e-3
    assert np.linalg.norm(moved - share * along) < 0.2 * np.linalg.norm(moved)


def test_plain_iteration_that_diverges_says_failed():
    start, data, unknowns, _ = gear_train_case(SETTINGS["40 linear"], 0)
    result = updyn.update(start, data, unknowns, method="equation-error", solver="gauss-newton")
    assert result.status == "failed"
    assert not result.ok
    assert "trust-region" in result.remedy
    assert np.isfinite(vector(result)).all()


@pytest.mark.parametrize("reading", [0, 1])
@pytest.mark.parametrize("lines", SETTINGS)
@pytest.mark.parametrize(
    "options", [{"method": "equation-error"}, {}], ids=["equation-error", "default"]
)
def test_more_lines_recover_all_18_unknowns(lines, reading, options):
    start, data, unknowns, truth = gear_train_case(SETTINGS[lines], reading)
    result = updyn.update(start, data, unknowns, **options)
    assert result.status == "converged"
    assert vector(result) == pytest.approx(truth, rel=1e-8, abs=1e-8)
    assert result.identifiability.rank == 18
    assert all(np.isfinite(s) for s in result.std.values())


# -- methods on exact data -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", GENERAL)
def test_every_method_recovers_the_chain_from_exact_data(chain12, chain12_true, chain12_frf, name):
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    result = updyn.update(chain12, chain12_frf, unknowns, method=name)
    assert result.status == "converged"
    for p in unknowns:
        true, start = chain12_true.group(p.group), chain12.group(p.group)
        if p.quantity == "loss_factor":
            exact = true.loss_factor
        else:
            exact = abs(getattr(true, p.quantity)).sum() / abs(getattr(start, p.quantity)).sum()
        assert result.values[p.name] == pytest.approx(exact, rel=1e-7), p.name
    assert result.model.group("part2").loss_factor == pytest.approx(
        chain12_true.group("part2").loss_factor, rel=1e-7
    )


@pytest.mark.parametrize("name", ["log", "output-error", "equation-error"])
def test_quantity_of_the_data_does_not_matter(chain12, chain12_frf, add_noise, name):
    """Log residuals and equation errors are the same numbers for receptance and accelerance; output errors are not."""
    data = add_noise(chain12_frf, np.random.default_rng(1), 0.01)
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    fits = [
        updyn.update(chain12, d, unknowns, method=name)
        for d in (data, data.converted("accelerance"))
    ]
    one, two = (vector(f) for f in fits)
    std = np.array(list(fits[0].std.values()))
    if name == "output-error":
        assert np.abs(one - two).max() > 1e-6
        assert (np.abs(one - two) < 20 * std).all()
    else:
        assert two == pytest.approx(one, rel=1e-7, abs=1e-9)
        # The floor of the noise that log estimates is a share of another rms.
        assert np.array(list(fits[1].std.values())) == pytest.approx(
            std, rel=0.01 if name == "log" else 1e-5
        )


def test_signs_of_sensors_do_not_matter(chain12, chain12_frf, add_noise):
    data = add_noise(chain12_frf, np.random.default_rng(1), 0.01)
    turned = data.select(
        responses=["2:-X", "5:X", "7:-X", "10:X", "12:-X"], references=["2:X", "5:-X", "7:X"]
    )
    same = data.select(references=["2:X", "5:X", "7:X"])
    unknowns = updyn.parameters(chain12, stiffness="all", loss_factor="all")
    for name in GENERAL:
        one, two = (vector(updyn.update(chain12, d, unknowns, method=name)) for d in (same, turned))
        assert two == pytest.approx(one, rel=1e-8)


@pytest.mark.parametrize("name", GENERAL)
def test_unit_of_length_does_not_matter(mixed_model, add_noise, name):
    """Translations beside rotations, in metres and in millimetres: the same noisy test gives the same unknowns."""
    fits = []
    for length in (1.0, 1e-3):
        start = mixed_model(length)
        true = start.scaled(
            {"a": {"stiffness": 1.1, "loss_factor": 0.05}, "b": {"stiffness": 0.9, "mass": 1.05}}
        )
        responses = ["1:Y", "2:RZ", "3:Y", "4:RZ"]
        clean = updyn.response(true, np.linspace(2, 60, 50), responses, ["1:Y", "2:RZ"])
        # Relative noise, so that it is the same measurement in both units.
        data = add_noise(clean, np.random.default_rng(3), relative=0.02)
        unknowns = updyn.parameters(start, stiffness="all", mass=["b"], loss_factor="all")
        fits.append(updyn.update(start, data, unknowns, method=name))
    assert vector(fits[1]) == pytest.approx(vector(fits[0]), rel=1e-6)
    assert list(fits[1].std.values()) == pytest.approx(list(fits[0].std.values()), rel=1e-4)


# -- priors ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", GENERAL)
def test_wide_prior_hardly_moves_what_the_data_know(chain12, chain12_frf, add_noise, name):
    """Data know the chain to 0.1-1 %; a prior of 30 % weighs 1e-3 of that, whatever unit the residual has."""
    data = add_noise(chain12_frf, np.random.default_rng(2), 0.01)
    every = {"stiffness": "all", "mass": "all", "loss_factor": "all"}
    bare, prior = (
        updyn.update(chain12, data, updyn.parameters(chain12, **every, prior_std=p), method=name)
        for p in (None, {"stiffness": 0.3, "mass": 0.3})
    )
    std = np.array(list(bare.std.values()))
    assert (np.abs(vector(prior) - vector(bare)) < 0.25 * std + 1e-9).all()
    assert np.array(list(prior.std.values())) == pytest.approx(std, rel=0.05)


def test_plain_iteration_refuses_priors(chain12, chain12_frf):
    unknowns = updyn.parameters(chain12, stiffness="all", prior_std={"stiffness": 0.3})
    with pytest.raises(OptionError, match="does not support priors"):
        updyn.update(chain12, chain12_frf, unknowns, method="equation-error", solver="gauss-newton")


def test_equation_error_without_drive_point_is_refused(chain12, chain12_frf):
    data = chain12_frf.select(responses=["2:X", "5:X"], references=["12:X"])
    unknowns = updyn.parameters(chain12, stiffness="all")
    with pytest.raises(DataError, match="reference 12:X is not among the responses"):
        updyn.update(chain12, data, unknowns, method="equation-error")


def test_weights_and_estimate_that_swing_are_no_convergence():
    """Unknowns that are tied wrongly: of two minima each makes the weights of the other."""
    groups = {}
    for i in range(4):
        K, M = np.zeros((4, 4)), np.zeros((4, 4))
        K[i, i], M[i, i] = 1e4, 1.0
        if i:
            K[i - 1, i - 1], K[i - 1, i], K[i, i - 1] = 1e4, -1e4, -1e4
        groups[f"p{i + 1}"] = updyn.Group(K, M, loss_factor=0.02)
    model = updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(4)])
    changes = {
        "p1": {"stiffness": 1.2, "mass": 0.9, "loss_factor": 0.03},
        "p2": {"stiffness": 0.8},
        "p3": {"mass": 1.1, "loss_factor": 0.01},
    }
    true, lines = model.scaled(changes), np.linspace(2.0, 32.0, 40)
    frf = updyn.response(true, lines, true.dofs.labels, ["4:X"], "accelerance")
    unknowns = updyn.link(model, "both.stiffness", ["p1.stiffness", "p2.stiffness"])
    unknowns += updyn.link(model, "third.size", {"p3.stiffness": 3.0, "p3.mass": 1.0})
    unknowns += updyn.link(model, "both.loss", ["p1.loss_factor", "p2.loss_factor"])
    result = updyn.update(model, frf, unknowns, starts=0, max_iterations=1000)
    assert result.status == "stalled"
    assert "do not converge together" in result.message
    assert not result.trust["converged"]
