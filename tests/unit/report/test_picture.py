"""The picture of the structure: groups of lines, changes, colours, labels; by value and by hand-made structures."""

from __future__ import annotations

import dataclasses
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

import updyn
from overriding import override
from report_case import realistic, smallest
from updyn.geometry import Geometry
from updyn.model import Group, Model
from updyn.report.page import render
from updyn.report.picture import spread_heights
from updyn.report.settings import REPORT_SIZE
from updyn.report.structure import STEPS, group_changes, group_remarks, structure_of
from updyn.updating.result import JointResult
from updyn.viewer.groups import groups_of_lines, nodes_of_groups

SPRING = np.array([[1.0, -1.0], [-1.0, 1.0]])


def spring(n: int, i: int, j: int, k: float) -> np.ndarray:
    K = np.zeros((n, n))
    K[np.ix_([i, j], [i, j])] = k * SPRING
    return K


def square(extra: dict[str, Group] | None = None) -> Model:
    """Nodes 10, 20, 30, 40 around a square, one DOF each but 40, which is held; a lump on 20."""
    n = 3
    groups = {
        "first": Group(spring(n, 0, 1, 100.0)),
        "second": Group(spring(n, 1, 2, 50.0)),
        "weak": Group(spring(n, 0, 1, 99.0)),
        "held": Group(np.diag([0.0, 0.0, 500.0])),  # from 30 to 40, which is gone
        "lump": Group(mass=np.diag([0.0, 2.0, 0.0])),
        "rest": Group(mass=np.eye(n)),
    } | (extra or {})
    xyz = [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1], [2, 0, 2]]
    lines = [[20, 10], [20, 30], [30, 40], [40, 50], [10, 30]]
    return Model.from_groups(
        groups, ["10:X", "20:X", "30:X"], geometry=Geometry([10, 20, 30, 40, 50], xyz, lines)
    )


def fitted(model: Model, values: dict[str, float], responses=("10:X",)):
    """A result whose unknowns came out at `values`."""
    by: dict[str, list[str]] = {}
    for name in values:
        group, _, quantity = name.rpartition(".")
        by.setdefault(quantity, []).append(group)
    chosen = updyn.parameters(model, **by)
    frf = updyn.response(model, [1.0, 2.0], responses, ["30:-X"])
    found = {
        "std": dict.fromkeys(values, 0.01),
        "covariance": 1e-4 * np.eye(len(values)),
        "lines": frf.freq,
        "fitted_responses": tuple(frf.responses.labels),
    }
    return dataclasses.replace(
        smallest(), start=model, model=model, data=frf, parameters=chosen, values=values, **found
    )


def test_a_line_belongs_to_the_group_that_couples_its_ends_most() -> None:
    names = [*square().groups]
    found = groups_of_lines(square())
    assert [names[i] if i >= 0 else None for i in found] == ["first", "second", "held", None, None]
    stiffer = groups_of_lines(square({"third": Group(spring(3, 0, 1, 101.0))}))
    assert stiffer[0] == len(names)


def test_lines_of_a_frame_with_rigid_ends_are_those_of_its_beams() -> None:
    structures = pytest.importorskip("updyn.elements.structure")
    pytest.importorskip("pyfe3d")
    steel = {"E": 2e11, "rho": 7800.0}
    model = structures.structure(
        {1: [0, 0, 0], 2: [1, 0, 0], 3: [2, 0, 0], 4: [2, 0, 1], 5: [3, 0, 1]},
        [
            structures.Beam("left", [[1, 2]], section=structures.tube(0.1), **steel),
            structures.Beam("right", [[2, 3]], section=structures.tube(0.05), **steel),
            structures.Beam("end", [[4, 5]], section=structures.tube(0.05), **steel),
        ],
        links=[structures.RigidLink(3, [4])],
        grounded=[1],
    )
    assert model.geometry is not None
    names = {
        tuple(line): list(model.groups)[i]
        for line, i in zip(model.geometry.lines.tolist(), groups_of_lines(model), strict=True)
    }
    assert names == {(1, 2): "left", (2, 3): "right", (4, 5): "end"}


def test_groups_without_lines_are_marked_where_they_are() -> None:
    model = square()
    index = {name: i for i, name in enumerate(model.groups)}
    found = nodes_of_groups(model, np.array([index["lump"], index["rest"]]), most=2)
    assert {k: v.tolist() for k, v in found.items()} == {index["lump"]: [1]}


def test_the_change_of_a_group_is_that_of_its_stiffness_then_mass() -> None:
    result = fitted(square(), {"first.stiffness": 0.8, "lump.mass": 1.25, "first.loss_factor": 0.3})
    assert group_changes(result) == {"first": ("stiffness", 0.8), "lump": ("mass", 1.25)}


def test_linked_unknowns_colour_all_that_they_drive_by_their_powers() -> None:
    model = square()
    linked = updyn.link(model, "part.thickness", {"first.stiffness": 1, "second.stiffness": 3})
    result = dataclasses.replace(
        smallest(), start=model, model=model, parameters=linked, values={"part.thickness": 1.1}
    )
    assert group_changes(result)["second"] == ("stiffness", pytest.approx(1.331))


def test_the_picture_says_where_what_and_how_much() -> None:
    result = fitted(
        square(),
        {"first.stiffness": 0.5, "second.stiffness": 2.0, "lump.mass": 1.0},
        responses=["10:X", "20:-X"],
    )
    page = structure_of([result])
    picture = ET.fromstring(page[page.index("<svg") : page.index("</svg>") + 6])
    by_class: dict[str, list[ET.Element]] = {}
    for element in picture.iter():
        by_class.setdefault(element.get("class", ""), []).append(element)
    assert [e.findtext("title") for e in by_class[f"s-{STEPS}"]] == ["first: stiffness \u221250 %"]
    assert [e.findtext("title") for e in by_class[f"s{STEPS}"]] == ["second: stiffness +100 %"]
    assert [(e.tag, e.findtext("title")) for e in by_class["s0"]] == [
        ("rect", "lump: mass 0 %, not significant")
    ]
    assert sum(e.get("d", "").count("M") for e in by_class["s-none"]) == 3
    assert sorted(e.text or "" for e in by_class["label"]) == ["10: X", "20: -X"]
    assert [e.text for e in by_class["label force"]] == ["30: force -X"]
    # Nothing leaves the picture.
    numbers = [float(x) for e in picture.iter() for x in re.findall(r"-?\d+\.?\d*", e.get("d", ""))]
    assert min(numbers) >= 0.0
    assert max(numbers[0::2]) <= 1130.0
    assert max(numbers[1::2]) <= 1130.0


def test_a_small_significant_change_beside_a_large_one_is_not_shown_as_none() -> None:
    changed = structure_of([fitted(square(), {"first.stiffness": 3.0, "second.stiffness": 1.025})])
    assert '<i class="s1"></i>second: stiffness +2.5 %' in changed


def test_changes_within_their_interval_have_no_colour_and_are_said_so() -> None:
    """The standard deviation is 0.01: 1.5 % is within the 95 % interval, whatever else changed."""
    same = structure_of([fitted(square(), {"first.stiffness": 3.0, "second.stiffness": 1.015})])
    assert '<i class="s0"></i>second: stiffness +1.5 %, not significant' in same
    open_ = fitted(square(), {"first.stiffness": 3.0, "second.stiffness": 2.0})
    found = dataclasses.replace(open_, std={"first.stiffness": 0.01, "second.stiffness": np.inf})
    assert '<i class="s0"></i>second: stiffness +100 %, not determined' in structure_of([found])
    assert group_remarks(found) == {"first": "", "second": "not determined"}


def test_the_colours_reach_to_the_largest_significant_change() -> None:
    small = structure_of([fitted(square(), {"first.stiffness": 0.97, "second.stiffness": 1.0})])
    assert f'<i class="s-{STEPS}"></i>first: stiffness \u22123 %' in small
    assert f'<i class="s-{STEPS}"></i>\u22123 %</span>' in small


def test_a_sensor_without_a_position_is_named() -> None:
    model = square()
    bare = dataclasses.replace(
        model, geometry=Geometry([10, 20], [[0, 0, 0], [1, 0, 0]], [[10, 20]])
    )
    assert "Without a position in the geometry, and not drawn: 30:-X." in structure_of(
        [fitted(bare, {"first.stiffness": 1.1})]
    )


def test_names_are_escaped() -> None:
    model = square({"<b>&": Group(spring(3, 0, 2, 1.0))})
    page = structure_of([fitted(model, {"<b>&.stiffness": 1.1})])
    assert "<b>" not in page
    assert "&lt;b&gt;&amp;: stiffness +10 %" in page


def test_without_a_geometry_there_is_no_section() -> None:
    page = render(realistic())
    assert 'id="structure"' not in page
    assert 'href="#viewer"' not in page
    with_one = render(fitted(square(), {"first.stiffness": 1.1}))
    assert with_one.count(">Structure</a>") == 1  # of the viewer and the picture
    assert with_one.index('href="#viewer"') < with_one.index('id="structure"')


def test_the_viewer_is_the_first_section_and_the_picture_follows() -> None:
    assert 'id="viewer"' not in render(realistic())  # no geometry
    page = render(fitted(square(), {"first.stiffness": 1.1}))
    names = ("verdict", "viewer", "structure", "changes")
    order = [page.index(f'<section id="{name}"') for name in names]
    assert order == sorted(order)
    viewer = page[order[1] : order[2]]
    assert "data-scene=" in viewer
    assert viewer.count('<details class="fold">') == 1


def test_the_page_of_several_tests_shows_the_sensors_of_all() -> None:
    held = fitted(square(), {"first.stiffness": 1.1}, ["20:X"])
    free = fitted(square(), {"first.stiffness": 1.1}, ["30:X"])
    page = render(JointResult({"held": held, "free": free}))
    assert page.count('id="structure"') == 1
    section = page[page.index('id="structure"') :]
    assert ">20: X</text>" in section
    assert ">30: X · force -X</text>" in section


def test_labels_keep_apart_and_inside() -> None:
    rng = np.random.default_rng(1)
    for n in (1, 5, 30):
        out = spread_heights(np.sort(rng.uniform(200.0, 260.0, n)), 16.0, 16.0, 640.0)
        assert (np.diff(out) >= 16.0 - 1e-9).all()
        assert out.min() >= 16.0
        assert out.max() <= 640.0
    np.testing.assert_allclose(
        spread_heights(np.array([50.0, 100.0, 300.0]), 16.0, 16.0, 640.0), [50.0, 100.0, 300.0]
    )
    np.testing.assert_allclose(
        spread_heights(np.array([638.0, 640.0]), 16.0, 16.0, 640.0), [624.0, 640.0]
    )


def test_a_large_geometry_is_thinned_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    override(monkeypatch, REPORT_SIZE, structure_lines=3)
    page = structure_of([fitted(square(), {"first.stiffness": 1.1})])
    assert "3 of the 5 lines of the geometry are drawn." in page
