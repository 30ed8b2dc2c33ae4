"""Exchanged section axes are named as the cause, before a fit and after it."""

from itertools import pairwise

import numpy as np
import pytest

import updyn
from overriding import override
from updyn.elements.beam import beam
from updyn.elements.structure import Beam, rectangle, structure
from updyn.settings import VARIANTS
from updyn.updating.judge.causes.data_alone import with_variance
from updyn.updating.judge.causes.other_model import CompiledVariant
from updyn.updating.judge.causes.promising import list_variants, select_variants
from updyn.updating.judge.causes.trial import Trial, raise_loss_factors
from updyn.updating.judge.counterparts import find_counterparts
from updyn.updating.problem.noise import choose_noise
from updyn.updating.problem.problem import FRFPart
from updyn.updating.problem.session import RecentCache, Session

GROUPS = ("left", "girder", "right")
#: What the start of an update is off by: stiffness and mass of each group.
OFF = {"left": (0.8, 1.1), "girder": (1.25, 0.92), "right": (0.9, 1.05)}


def portal(turned=(), scaled=None, per=4, planar=True):
    """A portal frame in the XZ plane, flat bars on edge; `turned` groups lie flat."""
    top = {f"{side} {i}": [x, 0.0, 0.6 * i / per] for side, x in (("l", 0.0), ("r", 0.8))
           for i in range(per + 1)}  # fmt: skip
    top |= {f"g {i}": [0.8 * i / per, 0.0, 0.6] for i in range(1, per)}
    number = {name: k for k, name in enumerate(top, start=1)}
    rows = {
        "left": [number[f"l {i}"] for i in range(per + 1)],
        "right": [number[f"r {i}"] for i in range(per + 1)],
        "girder": [number[f"l {per}"], *(number[f"g {i}"] for i in range(1, per)),
                   number[f"r {per}"]],
    }  # fmt: skip
    section = rectangle(0.03, 0.008)
    parts = []
    for name in GROUPS:
        in_plane = [1.0, 0.0, 0.0] if name != "girder" else [0.0, 0.0, 1.0]
        own = section.exchanged if name in turned else section
        two = [[a, b] for a, b in pairwise(rows[name])]
        more = {"orientation": in_plane, "loss_factor": 0.02}
        parts.append(Beam(name, two, 2.1e11, 7850.0, own, **more))
    held = [number["l 0"], number["r 0"]]
    if planar:
        moving = [n for n in number.values() if n not in held]
        held += [f"{n}:{d}" for n in moving for d in ("Y", "RX", "RZ")]
    model = structure({number[k]: x for k, x in top.items()}, parts, grounded=held)
    scaled = scaled or {}
    return model.scaled({n: {"stiffness": k, "mass": m} for n, (k, m) in scaled.items()})


SENSORS = ["2:X", "4:X", "7:X", "9:X", "11:Z", "12:Z"]


@pytest.fixture(scope="module")
def frf(add_noise):
    true = portal()
    clean = updyn.response(true, np.linspace(20.0, 900.0, 60), SENSORS, ["4:X", "12:Z"])
    return add_noise(clean, np.random.default_rng(5), 0.01)


def unknowns(model):
    return updyn.parameters(model, stiffness="all", mass="all", loss_factor="all")


@pytest.mark.parametrize("turned", [("girder",), ("left", "girder", "right")])
def test_they_are_named_before_a_fit(frf, turned):
    start = portal(turned, OFF)
    first, *others = updyn.diagnose(start, frf, unknowns(start))
    assert (first.kind, set(first.channels), others) == ("wrong-axes", set(turned), [])
    assert first.odds > 1e6
    assert first.grave
    assert first.overruling
    assert first.written == ""
    assert first.statement.startswith("The section axes of the group")
    assert first.statement.endswith("are exchanged (Iy and Iz).")
    assert first.remedy.startswith("Exchange Iyy and Izz in the section of beam")
    turned_by = ", or turn its orientation by 90 degrees: [0.0, -1.0, 0.0] in place of"
    assert (turned_by in first.remedy) == (len(turned) == 1)


def test_they_are_not_named_in_data_of_the_model(frf):
    start = portal((), OFF)
    assert updyn.diagnose(start, frf, unknowns(start)) == ()


def test_they_are_named_beside_a_sensor_of_the_wrong_sign(frf):
    start = portal(("girder",), OFF)
    values = frf.values.copy()
    values[:, 2] *= -1.0
    faulty = updyn.FRF(frf.freq, values, frf.responses, frf.references, frf.quantity)
    found = updyn.diagnose(start, faulty, unknowns(start))
    assert {one.kind: one.channels for one in found} == {
        "wrong-axes": ("girder",),
        "sign": ("7:X",),
    }


def test_an_update_ends_with_them_as_its_one_next_step(frf):
    start = portal(GROUPS, OFF)
    with pytest.warns(updyn.errors.UpdynWarning, match="axes of the groups 'left', 'girder' and"):
        result = updyn.update(start, frf, unknowns(start))
    assert result.findings[0].kind == "wrong-axes"
    assert result.message.startswith("The section axes of the groups 'left', 'girder' and 'right'")
    assert result.remedy.startswith("Exchange Iyy and Izz in the section of beam 'left'")
    assert result.trust["plausible"].holds is False


def test_counterparts_of_modes_name_them(frf):
    true, wrong = portal(), portal(GROUPS)
    found = find_counterparts(wrong, frf)
    assert found.few
    assert found.statement.endswith(
        "have one in a variant: the section axes of the groups 'left', 'girder' and 'right' are"
        " exchanged (Iy and Iz)."
    )
    assert found.remedy.startswith("Exchange Iyy and Izz")
    assert find_counterparts(true, frf).remedy == ""


def test_a_stiffness_that_would_have_to_be_far_off_is_exchanged_axes(add_noise):
    about = {"E": 2e11, "rho": 7850.0, "n_elements": 12, "loss_factor": 0.01}
    places = {101: 0.0, 102: 0.13, 103: 0.3, 104: 0.5}
    right, wrong = (
        beam(0.5, width=w, height=h, stations=places, **about)
        for w, h in ((0.03, 0.01), (0.01, 0.03))
    )
    lines = np.linspace(100.0, 3000.0, 80)
    frf = updyn.response(right, lines, ["101:Z", "102:Z", "104:Z"], ["103:Z"])
    noisy = add_noise(frf, np.random.default_rng(2), 0.01)
    bounds = {"stiffness": (1e-3, 1e3)}
    sought = updyn.parameters(wrong, stiffness="beam", loss_factor="beam", bounds=bounds)
    (found,) = updyn.diagnose(wrong, noisy, sought)
    assert found.kind == "wrong-axes"
    assert found.remedy == "Exchange width and height of the beam: width = 0.03, height = 0.01."


def test_a_reduced_variant_answers_as_the_variant_does(frf):
    wrong, true = (portal(turned, OFF, per=14, planar=False) for turned in (("girder",), ()))
    places = [f"{n}:X" for n in (5, 12, 20)] + ["36:Z", "40:Z"]
    data = updyn.response(true, np.linspace(20.0, 400.0, 40), places, ["12:X", "40:Z"])
    data = with_variance(data, choose_noise({"relative": 0.01}, data))
    part = FRFPart.build(wrong, data, unknowns(wrong), session=Session(cache=RecentCache()))
    assert part.solver.system.n > 100
    other = next(one for one in list_variants(part) if one.variant.groups == ("girder",))
    home = part.coordinates.start
    as_it_is = part.responses(home)
    there = other.prepare_part(part, [home])
    assert there.solver.tier == "reduced"
    largest = np.abs(data.values).max(axis=(1, 2), keepdims=True)
    assert (np.abs(there.responses(home) - data.values) < 2e-3 * largest).all()
    np.testing.assert_allclose(other.replace_model(part).responses(home), data.values, rtol=1e-9)
    np.testing.assert_array_equal(part.responses(home), as_it_is)


@pytest.mark.parametrize(
    ("power", "far", "expected"),
    [(0.01**2, 1.0, []), (0.01**2, 30.0, [("girder",)]), (0.3**2, 1.0, [("girder",)])],
)
def test_they_are_tried_where_they_may_be_likely(frf, power, far, expected):
    """Noise alone near the start needs no other model: half of `far` has to outweigh the odds."""
    start = portal(("girder",), OFF)
    data = with_variance(frf, choose_noise({"relative": 0.01}, frf))
    part = FRFPart.build(start, data, unknowns(start))
    home = part.coordinates.start
    without = Trial(None, home, power, far, 0.0, 2 * part.n_values)
    found = select_variants(part, list_variants(part), without, raise_loss_factors(part, home))
    assert [one.channels for one in found] == expected


def test_none_are_tried_of_a_large_model(monkeypatch, frf):
    part = FRFPart.build(portal(("girder",)), frf, unknowns(portal()))
    assert [type(one) for one in list_variants(part)] == [CompiledVariant] * 4
    override(monkeypatch, VARIANTS, largest_model=30)
    assert list_variants(part) == []
