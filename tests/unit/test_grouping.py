"""Selection of groups by names, globs, ranges, materials and sets, and merged groups."""

from __future__ import annotations

import pickle
import re

import numpy as np
import pytest

from updyn.errors import ModelError
from updyn.group import Group
from updyn.grouping import GroupOrigin, match_names
from updyn.model import Model

NAMES = ["PSHELL 1", "PSHELL 2", "PSHELL 10", "PBAR 2", "part 1", "part 2", "part 1-2"]


def raises(text: str, kind: type[Exception] = ModelError):
    return pytest.raises(kind, match=re.escape(text))


@pytest.mark.parametrize(
    ("pattern", "found"),
    [
        ("PSHELL 1", ["PSHELL 1"]),
        ("PSHELL 1-9", ["PSHELL 1", "PSHELL 2"]),
        ("PSHELL 2-10", ["PSHELL 2", "PSHELL 10"]),
        ("P* 2-10", ["PSHELL 2", "PSHELL 10", "PBAR 2"]),
        ("PSHELL 10-2", []),
        ("PSHELL [1-2]", ["PSHELL 1", "PSHELL 2"]),
        ("PSHELL [0-9]", ["PSHELL 1", "PSHELL 2"]),
        ("PSHELL 1*", ["PSHELL 1", "PSHELL 10"]),
        ("part 1-2", ["part 1-2"]),
        ("part 1-3", ["part 1", "part 2"]),
        ("pshell 1-2", []),
        ("PSHELL 1-", []),
    ],
)
def test_names_match_a_glob_or_a_range(pattern, found):
    assert match_names(NAMES, pattern) == found


def test_a_range_may_have_text_after_it():
    names = ["wing 1 top", "wing 2 top", "wing 2 bottom", "wing 9 top"]
    assert match_names(names, "wing 1-3 top") == ["wing 1 top", "wing 2 top"]
    assert match_names(names, "wing 1-3 *") == ["wing 1 top", "wing 2 top", "wing 2 bottom"]


def spring(k: float, loss_factor: float = 0.02, **origin) -> Group:
    group = Group(np.diag([k, 0.0]), np.diag([0.1 * k, 0.0]), loss_factor=loss_factor)
    return group.with_origin(GroupOrigin(**origin))


@pytest.fixture
def model() -> Model:
    groups = {
        "PSHELL 1": spring(1.0, labels=("MAT1 3", "SET 7")),
        "PSHELL 2": spring(2.0, labels=("MAT1 4", "SET 7"), partial=("SET 8",)),
        "CONM2 10": Group(mass=np.diag([0.0, 5.0])),
        "PSHELL 3": spring(4.0, labels=("MAT1 3",)),
        "ground": Group(np.eye(2), viscous=np.eye(2), loss_factor=0.5),
    }
    return Model.from_groups(groups, ["1:X", "1:Y"], title="shells")


def test_merged_groups_sum_their_matrices_and_name_their_members(model):
    merged = model.merge_groups({"skin": "PSHELL 1-3", "mass": ["CONM2 1*"]})
    assert list(merged.groups) == ["skin", "mass", "ground"]
    skin = merged.group("skin")
    np.testing.assert_allclose(skin.stiffness.toarray(), np.diag([7.0, 0.0]), rtol=1e-15)
    np.testing.assert_allclose(skin.mass.toarray(), np.diag([0.7, 0.0]), rtol=1e-15)
    assert (skin.viscous, skin.loss_factor) == (None, 0.02)
    both = ("stiffness", "mass")
    assert skin.origin.members == {"PSHELL 1": both, "PSHELL 2": both, "PSHELL 3": both}
    assert merged.group("mass").origin.members == {"CONM2 10": ("mass",)}
    assert merged.group("ground") is model.group("ground")
    for what in ("stiffness", "mass", "viscous", "structural"):
        whole, before = getattr(merged, what), getattr(model, what)
        np.testing.assert_allclose(whole.toarray(), before.toarray(), rtol=1e-15)
    assert (merged.dofs, merged.title) == (model.dofs, "shells")


@pytest.mark.parametrize(
    ("pattern", "members"),
    [("MAT1 3", ["PSHELL 1", "PSHELL 3"]), ("SET 7", ["PSHELL 1", "PSHELL 2"])],
)
def test_a_group_of_a_material_or_a_set(model, pattern, members):
    assert list(model.merge_groups({"a": pattern}).group("a").origin.members) == members


def test_labels_of_a_merged_group_are_those_of_all_its_members(model):
    origin = model.merge_groups({"a": "PSHELL 1-2"}).group("a").origin
    assert origin.labels == ("SET 7",)
    assert set(origin.partial) == {"MAT1 3", "MAT1 4", "SET 8"}


def test_groups_can_be_merged_again(model):
    twice = model.merge_groups({"a": "PSHELL 1-2"}).merge_groups({"b": ["a", "PSHELL 3"]})
    assert list(twice.groups) == ["b", "CONM2 10", "ground"]
    assert list(twice.group("b").origin.members) == ["PSHELL 1", "PSHELL 2", "PSHELL 3"]


def test_a_merged_group_may_have_the_name_of_a_member(model):
    merged = model.merge_groups({"PSHELL 1": "PSHELL 1-2"})
    assert list(merged.groups) == ["PSHELL 1", "CONM2 10", "PSHELL 3", "ground"]


def test_changes_of_a_merged_group_are_changes_of_its_members(model):
    merged = model.merge_groups({"a": ["PSHELL 1", "CONM2 10"]})
    changes = {"a": {"stiffness": 1.1, "mass": 1.2, "loss_factor": 0.3}, "ground": {"viscous": 2.0}}
    original = merged.split_changes(changes)
    assert original == {
        "PSHELL 1": {"stiffness": 1.1, "mass": 1.2, "loss_factor": 0.3},
        "CONM2 10": {"mass": 1.2},
        "ground": {"viscous": 2.0},
    }
    a, b = merged.scaled(changes), model.scaled(original)
    np.testing.assert_allclose(a.mass.toarray(), b.mass.toarray(), rtol=1e-15)
    np.testing.assert_allclose(a.structural.toarray(), b.structural.toarray(), rtol=1e-15)


def test_a_changed_group_keeps_its_origin(model):
    merged = model.merge_groups({"a": "PSHELL 1-2"})
    members = merged.group("a").origin.members
    for changed in (
        merged.scaled({"a": {"stiffness": 2.0}}),
        merged.with_damping({"a": {"loss_factor": 0.1}}),
        pickle.loads(pickle.dumps(merged)),  # noqa: S301
    ):
        assert changed.group("a").origin.members == members


@pytest.mark.parametrize(
    ("groups", "text"),
    [
        ({"a": "PSHEL 1-2"}, "groups: a: no group 'PSHEL 1-2'; did you mean 'PSHELL"),
        ({"a": "MAT1 5"}, "groups: a: no group 'MAT1 5'; did you mean 'MAT1"),
        ({"a": "SET 8"}, "'SET 8' contains only a part of group 'PSHELL 2'"),
        (
            {"a": "PSHELL 1-2", "b": ["ground", "PSHELL *"]},
            "groups: 'PSHELL 1' is in 'a' and in 'b'; expected one of them",
        ),
        ({"a": ["PSHELL 1", "ground"]}, "groups: a: loss_factor is 0.02 in 'PSHELL 1' and 0.5 in"),
        ({"a": []}, "groups: a: expected a pattern or a list of them, found []"),
        ({"a": 3}, "groups: a: expected a pattern or a list of them, found 3"),
        ({"a": ["PSHELL 1", 3]}, "groups: a: expected a pattern or a list of them, found 3"),
        ({"ground": "PSHELL 1"}, "groups: 'ground' is the name of another group"),
        ({"a.b": "PSHELL 1"}, "group name 'a.b' holds '.'"),
        ({}, "groups: expected names with patterns, found {}"),
        ("wing", "groups: expected names with patterns, found 'wing'"),
    ],
)
def test_wrong_groups_are_named(model, groups, text):
    with raises(text):
        model.merge_groups(groups)


def test_the_key_of_an_error_is_the_new_group(model):
    with pytest.raises(ModelError) as error:
        model.merge_groups({"a": "PSHELL 1", "b": "PSHEL*"})
    assert error.value.key == ("groups", "b")


def test_damping_on_a_missing_matrix_does_not_have_to_agree(model):
    merged = model.merge_groups({"a": ["CONM2 10", "ground"]})
    assert merged.group("a").loss_factor == 0.5


def test_different_loss_tables_are_refused():
    table = ([1.0, 10.0], [1.0, 2.0])
    groups = {name: Group(np.eye(1), loss_factor=0.1, loss_table=table) for name in "ab"}
    groups["c"] = Group(np.eye(1), loss_factor=0.1, loss_table=([1.0, 10.0], [1.0, 3.0]))
    model = Model.from_groups(groups, ["1:X"])
    kept = model.merge_groups({"ab": ["a", "b"]}).group("ab")
    assert kept.loss_table.relative.tolist() == [1.0, 2.0]
    with raises("groups: bc: loss_table differs between 'b' and 'c'"):
        model.merge_groups({"bc": ["b", "c"]})


def test_patterns_select_unknowns_in_the_same_way(model):
    from updyn.updating.problem.parameters import link, parameters

    chosen = parameters(model, stiffness=["PSHELL 2-3"], mass="PSHELL *")
    assert chosen.names == [
        "PSHELL 1.mass",
        "PSHELL 2.mass",
        "PSHELL 2.stiffness",
        "PSHELL 3.mass",
        "PSHELL 3.stiffness",
    ]
    linked = link(model, "skin.factor", ["PSHELL 1-2.stiffness"])
    assert [drive.group for drive in linked[0].drives] == ["PSHELL 1", "PSHELL 2"]
