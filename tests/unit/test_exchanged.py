"""Exchanged section axes of a group: by value those of a model that is built with them."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import updyn
from updyn.dofs import Dof
from updyn.elements.beam import Segment, beam
from updyn.elements.constraints import Equation, constrain, join
from updyn.elements.structure import Beam, RigidLink, Section, Truss, rectangle, structure
from updyn.errors import ModelError
from updyn.io.hdf5 import read_model, write_model
from updyn.matching.directions import SensorDirection, assign_dofs
from updyn.variants import build_variants

NODES = {
    1: [0.0, 0.0, 0.0],
    2: [0.4, 0.0, 0.0],
    3: [0.8, 0.1, 0.2],
    4: [0.8, 0.9, 0.2],
    5: [0.9, 0.9, 0.2],
}
TIMBER = {"E": 1.1e10, "rho": 480.0, "loss_factor": 0.01}
OBLONG = Section(2.4e-4, 1.28e-9, 1.8e-8, 4.2e-9, 0.82, 0.79)


def girder(section: Section, orientation: list[float]) -> Beam:
    return Beam("girders", [[1, 2], [2, 3]], section=section, orientation=orientation, **TIMBER)


def frame(girders: Section, cross: Section = OBLONG, *, up: list[float] | None = None):
    parts = [
        girder(girders, up or [0.0, 0.0, 1.0]),
        Beam("cross", [[3, 4]], section=cross, orientation=[0.0, 0.0, 1.0], **TIMBER),
        Truss("stay", [[1, 4]], 2.1e11, 7850.0, 1e-5),
    ]
    links = [RigidLink(4, [5])]
    tip = Beam("girders", [[4, 5]], section=girders, orientation=[0.0, 0.0, 1.0], **TIMBER)
    return structure(NODES, [*parts, tip], links=links, grounded=[1])


def assert_same(model, other, rtol=1e-12):
    assert list(model.groups) == list(other.groups)
    for name, group in model.groups.items():
        for what in ("stiffness", "mass"):
            a, b = (getattr(one, what) for one in (group, other.group(name)))
            assert (a is None) == (b is None)
            if b is None:
                continue
            scale = np.abs(b.data).max()
            np.testing.assert_allclose(a.toarray(), b.toarray(), rtol=0, atol=rtol * scale)
        assert group.loss_factor == other.group(name).loss_factor


def test_a_variant_is_the_model_that_is_built_with_exchanged_axes():
    turned = Section(OBLONG.A, OBLONG.Izz, OBLONG.Iyy, OBLONG.J, OBLONG.shear_z, OBLONG.shear_y)
    model = frame(OBLONG)
    one, other, both = build_variants(model)
    assert (one.groups, other.groups) == (("girders",), ("cross",))
    assert both.groups == ("girders", "cross")
    assert_same(one.model(), frame(turned))
    assert_same(other.model(), frame(OBLONG, turned))
    assert_same(both.model(), frame(turned, turned))


def test_an_orientation_turned_by_90_degrees_is_the_same_mistake():
    nodes = {1: [0.0, 0.0, 0.0], 2: [0.4, 0.3, 0.0], 3: [0.8, 0.6, 0.0]}

    def strut(orientation):
        part = Beam("strut", [[1, 2], [2, 3]], section=OBLONG, orientation=orientation, **TIMBER)
        return structure(nodes, [part], grounded=[1])

    (variant,) = build_variants(strut([0.0, 0.0, 2.0]))
    assert "[0.6, -0.8, 0.0] in place of [0.0, 0.0, 2.0]" in variant.remedy
    assert "Exchange Iyy and Izz in the section of beam 'strut'" in variant.remedy
    assert variant.mistake == "the section axes of the group 'strut' are exchanged (Iy and Iz)"
    assert_same(variant.model(), strut([0.6, -0.8, 0.0]))


def test_exchanging_round_sections_changes_nothing_and_is_no_variant():
    assert build_variants(frame(Section(1e-4, 2e-9, 2e-9, 4e-9), rectangle(0.02, 0.02))) == ()


def test_a_variant_follows_the_model_through_scaling_damping_ties_and_joining():
    turned = OBLONG.exchanged
    factors = {"girders": {"stiffness": 1.3, "mass": 0.8, "loss_factor": 0.02}}
    tie = [Equation("4:Z", {"3:Z": 1.0, "3:RX": 0.8})]

    def changed(model):
        free = updyn.Model.from_groups({"box": updyn.Group(mass=np.eye(1))}, ["2:Y"])
        scaled = join([model.scaled(factors), free])
        damped = scaled.with_damping({"girders": {"stiffness_damping": 1e-5}})
        return constrain(damped, tie, ["3:RY"])

    (one, *_) = build_variants(changed(frame(OBLONG)))
    assert_same(one.model(), changed(frame(turned)))
    assert one.model().group("girders").stiffness_damping == 1e-5


def test_a_variant_follows_turned_directions_of_the_nodes():
    oblique = np.array([0.6, 0.8, 0.0])
    target = SensorDirection(Dof.parse("3:X"), "response", Dof.parse("3:X"), oblique)
    (one, *_) = build_variants(assign_dofs(frame(OBLONG), [target], 0.1)[0])
    assert_same(one.model(), assign_dofs(frame(OBLONG.exchanged), [target], 0.1)[0])


def test_exchanged_width_and_height_of_a_planar_beam():
    about = {"E": 2e11, "rho": 7850.0, "n_elements": 4, "loss_factor": 0.01}
    segments = [("thick", 0.0, 0.3), Segment("thin", 0.3, 0.5, height=0.004)]
    model = beam(0.5, width=0.05, height=0.01, segments=segments, **about)
    _, thin, both = build_variants(model)
    turned = [("thick", 0.0, 0.3), Segment("thin", 0.3, 0.5, width=0.004, height=0.05)]
    assert_same(thin.model(), beam(0.5, width=0.05, height=0.01, segments=turned, **about))
    assert thin.remedy == (
        "Exchange width and height of segment 'thin': width = 0.004, height = 0.05."
    )
    turned[0] = Segment("thick", 0.0, 0.3, width=0.01, height=0.05)
    assert_same(both.model(), beam(0.5, width=0.05, height=0.01, segments=turned, **about))
    square = beam(0.5, width=0.01, height=0.01, **about)
    assert build_variants(square) == ()


def test_variants_are_sent_to_processes_and_not_stored(tmp_path):
    model = frame(OBLONG)
    sent = pickle.loads(pickle.dumps(model))  # noqa: S301
    assert_same(build_variants(sent)[0].model(), build_variants(model)[0].model(), rtol=0.0)
    write_model(model, tmp_path / "frame.h5")
    assert build_variants(read_model(tmp_path / "frame.h5")) == ()


def test_other_matrices_have_no_variant():
    group = frame(OBLONG).group("girders")
    assert replace(group, stiffness=2.0 * group.stiffness).exchanged is None
    with pytest.raises(ModelError, match="no beams whose section axes are known"):
        group.with_exchanged_axes().with_exchanged_axes()


def test_a_merged_group_has_the_axes_of_all_its_beams_exchanged():
    model = frame(rectangle(0.06, 0.02)).with_damping({"stay": {"loss_factor": 0.01}})
    alone = [model.group(name).with_exchanged_axes() for name in ("girders", "cross")]
    merged = model.merge_groups({"all of it": "*"}).group("all of it")
    doubled = merged.changed({"stiffness": 2.0})
    parts = [*alone, model.group("stay")]
    for what, found, factor in (("stiffness", doubled, 2.0), ("mass", merged, 1.0)):
        expected = factor * sum(getattr(part, what).toarray() for part in parts)
        turned = getattr(found.with_exchanged_axes(), what).toarray()
        np.testing.assert_allclose(turned, expected, rtol=0, atol=1e-12 * abs(expected).max())
    assert "cross" in merged.exchanged.what
    assert "girders" in merged.exchanged.what
