"""A loss factor that varies with frequency is named, with its course and the table for the job."""

import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.updating.judge.causes.evidence import Evidence
from updyn.updating.judge.causes.loss_over_frequency import LossOverFrequency
from updyn.updating.problem.problem import FRFPart

SENSORS = ["2:X", "5:X", "7:X", "10:X", "12:X"]
FORCES = ["5:X", "12:X"]
LINES = np.linspace(0.6, 22.0, 100)
MIDDLE = np.sqrt(0.6 * 22.0)


@pytest.fixture(scope="module")
def unknowns(chain12):
    return updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")


def with_course(model, group, exponent, loss, lines=LINES):
    """The loss factor of a group by a table: loss (f / middle)^exponent."""
    freq = np.append(lines, 100.0)
    above = np.where(freq > 0.0, freq, lines[lines > 0.0][0])
    table = (freq, (above / MIDDLE) ** exponent)
    return model.with_damping({group: {"loss_factor": loss, "loss_table": table}})


def measured(model, add_noise, lines=LINES, seed=3, **options):
    frf = updyn.response(model, lines, SENSORS, FORCES, **options)
    return add_noise(frf, np.random.default_rng(seed), 0.01)


def causal_response(model, frf, group, exponent, loss):
    """H of the model with a modulus of (i f)^exponent in a group, line by line, in its quantity.

    The loss modulus is loss times the stiffness amid the band, and so is the change of the storage
    modulus 0 there.
    """
    mass = sum(g.mass.toarray() for g in model.groups.values() if g.mass is not None)
    labels = model.dofs.labels
    at = [[labels.index(str(abs(d))) for d in dofs] for dofs in (frf.responses, frf.references)]
    scale = loss / np.sin(0.5 * np.pi * exponent)
    H = []
    for f in frf.freq:
        Z = -((2.0 * np.pi * f) ** 2) * mass.astype(complex)
        for name, g in model.groups.items():
            if g.stiffness is not None:
                more = 1j * g.loss_factor
                if name == group:
                    more = scale * (1j * f / MIDDLE) ** exponent
                    more -= scale * np.cos(0.5 * np.pi * exponent)
                Z += (1.0 + more) * g.stiffness.toarray()
        U = np.linalg.solve(Z, np.eye(len(Z))[:, at[1]])
        H.append(U[at[0]] * (2j * np.pi * f) ** 2)
    sign = frf.responses.signs[:, None] * frf.references.signs
    return np.array(H) * sign


def cause(exponent, group="part2"):
    groups = () if group == "all" else (group,)
    return LossOverFrequency((f"{group}.loss_factor",), exponent, groups, MIDDLE)


@pytest.mark.parametrize(("group", "exponent"), [("part2", 0.4), ("all", -0.7)])
@pytest.mark.parametrize(("quantity", "decay"), [("mobility", 0.0), ("accelerance", 0.4)])
def test_slopes_by_the_exponent(chain12, unknowns, group, exponent, quantity, decay):
    """Of the model with the course as a table, by central differences."""
    where = (LINES[::9], ["2:X", "5:-X"], ["5:X"], quantity)
    part = FRFPart.build(chain12, updyn.response(chain12, *where, decay=decay), unknowns)
    x = part.coordinates.start + 0.05
    groups = [n for n, g in chain12.groups.items() if g.stiffness is not None]
    groups = groups if group == "all" else [group]

    def log_response(p):
        true = chain12
        for one in groups:
            true = with_course(true, one, p, 0.01)
        return np.log(FRFPart.build(true, part.frf, unknowns).responses(x))

    altered = cause(exponent, group).correct_part(part, x)
    np.testing.assert_allclose(np.log(altered.responses(x)), log_response(exponent), rtol=1e-10)
    for at, there in ((0.0, part), (exponent, altered)):
        slope = (log_response(at + 1e-4) - log_response(at - 1e-4)) / 2e-4
        found = cause(0.0, group).slope(Evidence(there, x))
        np.testing.assert_allclose(found, slope, atol=1e-6 * np.abs(slope).max())


@pytest.mark.parametrize("exponent", [0.4, -0.3, 0.003])
def test_the_storage_modulus_follows_kramers_and_kronig(chain12, exponent):
    """Values, derivatives by unknowns and by the exponent, of complex moduli line by line."""
    model = chain12.with_damping({"part2": {"loss_factor": 0.05}})
    unknowns = updyn.parameters(model, stiffness="all", loss_factor="all")
    frf = updyn.response(model, LINES[::9], ["2:X", "5:-X"], ["5:X"], "accelerance")
    part = FRFPart.build(model, frf, unknowns)
    x = part.coordinates.start
    fault = replace(cause(exponent), causal=True)
    altered = fault.correct_part(part, x)

    def log_response(p, loss=0.05):
        return np.log(causal_response(model, frf, "part2", p, loss))

    np.testing.assert_allclose(np.log(altered.responses(x)), log_response(exponent), rtol=1e-7)
    found = altered.block(x, slice(None))
    i = unknowns.names.index("part2.loss_factor")
    slope = (log_response(exponent, 0.05 + 1e-5) - log_response(exponent, 0.05 - 1e-5)) / 2e-5
    np.testing.assert_allclose(found.dH[i] / found.H, slope, atol=1e-6 * np.abs(slope).max())
    i = unknowns.names.index("part2.stiffness")
    stiffer = model.scaled({"part2": {"stiffness": 1.0 + 1e-5}})
    higher = np.log(causal_response(stiffer, frf, "part2", exponent, 0.05))
    slope = (higher - log_response(exponent)) / 1e-5
    np.testing.assert_allclose(found.dH[i] / found.H, slope, atol=1e-4 * np.abs(slope).max())
    slope = (log_response(exponent + 1e-3) - log_response(exponent - 1e-3)) / 2e-3
    by_exponent = replace(fault, value=0.0).slope(Evidence(altered, x))
    np.testing.assert_allclose(by_exponent, slope, atol=1e-4 * np.abs(slope).max())


def test_a_material_is_named_with_the_change_of_its_stiffness(
    chain12, chain12_true, unknowns, add_noise
):
    """Fractional Kelvin-Voigt: without that change the data would contradict the course."""
    frf = updyn.response(chain12_true, LINES, SENSORS, FORCES, "accelerance")
    values = causal_response(chain12_true, frf, "part2", 0.4, 0.08)
    data = add_noise(replace(frf, values=values), np.random.default_rng(3), 0.01)
    (found,) = updyn.diagnose(chain12, data, unknowns)
    assert (found.kind, found.channels) == ("loss-over-frequency", ("part2.loss_factor",))
    assert found.value == pytest.approx(0.4, abs=0.05)
    stiffer = float(re.search(r"its stiffness rises by (\S+) %", found.statement)[1])
    ends = (np.array([0.6, 22.0]) / MIDDLE) ** 0.4
    assert stiffer == pytest.approx(8.0 / np.tan(0.2 * np.pi) * np.ptp(ends), rel=0.1)
    assert "No table describes the change of the stiffness" in found.remedy


def test_at_0_hz_the_loss_factor_is_that_of_the_next_line(chain12, unknowns):
    lines = np.append(0.0, LINES[::9])
    frf = updyn.response(chain12, lines, ["2:X"], ["5:X"])
    part = FRFPart.build(chain12, frf, unknowns)
    x = part.coordinates.start + 0.05
    true = FRFPart.build(with_course(chain12, "part2", -0.5, 0.01, lines), frf, unknowns)
    altered = cause(-0.5).correct_part(part, x)
    np.testing.assert_allclose(altered.responses(x), true.responses(x), rtol=1e-10)


@pytest.mark.parametrize(
    ("exponent", "course", "sought"), [(0.4, "rises", True), (-0.4, "falls", False)]
)
def test_the_course_is_named_with_the_table_for_the_job(
    chain12, chain12_true, add_noise, exponent, course, sought
):
    """Whether the loss factor of the group is an unknown, or held in a model without damping."""
    true = with_course(chain12_true, "part2", exponent, 0.05)
    loss = "all" if sought else ["part1", "part3"]
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor=loss)
    (found,) = updyn.diagnose(chain12, measured(true, add_noise), unknowns)
    assert (found.kind, found.channels) == ("loss-over-frequency", ("part2.loss_factor",))
    assert found.value == pytest.approx(exponent, rel=0.2)
    ends = re.search(r"from (\S+) at (\S+) Hz to (\S+) at (\S+) Hz", found.statement).groups()
    *first, last, high = map(float, ends)
    assert f"The loss factor of the group 'part2' {course} with frequency" in found.statement
    assert first == pytest.approx([0.05 * (0.6 / MIDDLE) ** exponent, 0.6], rel=0.2)
    assert last == pytest.approx(0.05 * (22.0 / MIDDLE) ** exponent, rel=0.2)
    assert 21.5 < high <= 22.0
    # The table of the remedy gives the model the course of the structure.
    (damping,) = tomllib.loads("\n".join(found.step.lines))["damping"]
    assert damping.pop("groups") == "part2"
    repaired = chain12_true.with_damping({"part2": damping}).group("part2")
    wanted = true.group("part2")
    for f in LINES[::11]:
        there = repaired.loss_at(f, "part2")
        assert there == pytest.approx(wanted.loss_at(f, "part2"), rel=0.25)


def test_a_constant_loss_factor_is_no_course(chain12, chain12_true, unknowns, add_noise):
    true = chain12_true.with_damping({"part2": {"loss_factor": 0.05}})
    assert updyn.diagnose(chain12, measured(true, add_noise), unknowns) == ()


def test_of_a_narrow_band_viscous_damping_is_named_with_it(
    chain12, chain12_true, unknowns, add_noise
):
    """Over an octave f^0.9 and a constant with a share of f are the same."""
    lines = np.linspace(6.0, 12.0, 60)
    true = with_course(chain12_true, "part2", 0.9, 0.05, lines)
    (found, *_) = updyn.diagnose(chain12, measured(true, add_noise, lines), unknowns)
    names = {f"{found.kind}:{found.channels[0]}", *found.also}
    wanted = {"loss-over-frequency:part2.loss_factor", "missing-viscous:part2.stiffness_damping"}
    assert wanted <= names
    assert "A test over a wider band, or of the part alone" in found.statement


def test_a_course_that_is_given_is_not_doubted(chain12, unknowns):
    given = with_course(chain12, "part2", 0.4, 0.05)
    frf = updyn.response(given, LINES[::9], ["2:X"], ["5:X"])
    frf = replace(frf, variance=np.abs(frf.values) ** 2 * 1e-4)
    part = FRFPart.build(given, frf, unknowns)
    found = list(LossOverFrequency.propose_faults(Evidence(part, part.coordinates.start)))
    named = {one.channels[0] for one in found}
    assert "part1.loss_factor" in named
    assert "all.loss_factor" in named
    assert "part2.loss_factor" not in named


@pytest.mark.parametrize(("exponent", "possible"), [(0.0, False), (1.5, True), (-1.51, False)])
def test_no_loss_factor_is_much_steeper_than_that_of_a_dashpot(exponent, possible):
    assert cause(exponent).is_plausible() is possible


@pytest.mark.parametrize("rate", [1e-3, 2e-3])
def test_viscous_damping_is_named_before_its_general_form(chain12, chain12_true, add_noise, rate):
    """The loss factor of viscous damping is proportional to frequency."""
    undamped = chain12_true.scaled({name: {"loss_factor": 0.0} for name in chain12_true.groups})
    true = undamped.with_damping({name: {"stiffness_damping": rate} for name in undamped.groups})
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    (found,) = updyn.diagnose(
        chain12, measured(true, add_noise, np.linspace(0.6, 22.0, 100)), unknowns
    )
    assert (found.kind, found.channels) == ("missing-viscous", ("all.stiffness_damping",))
    assert found.value == pytest.approx(rate, rel=0.05)
    assert "loss-over-frequency:all.loss_factor" in found.also
    assert 'quantity = "stiffness_damping"' in found.remedy
