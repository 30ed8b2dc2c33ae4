"""DOFs: strict labels, order, sign, matching, complement, size."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import re

import numpy as np
import pytest

from updyn.dofs import DIRECTIONS, Dof, DofSet, whole_numbers
from updyn.errors import DofError, InputError


def raises(text: str):
    return pytest.raises(DofError, match=re.escape(text))


# -- one DOF -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("label", "node", "direction", "sign"),
    [
        ("12:Z", 12, "Z", 1),
        ("12:+Z", 12, "Z", 1),
        ("12:-Z", 12, "Z", -1),
        ("3:RX", 3, "RX", 1),
        ("3:-RY", 3, "RY", -1),
        ("0:X", 0, "X", 1),
        ("-5:Y", -5, "Y", 1),
        ("007:RZ", 7, "RZ", 1),
    ],
)
def test_labels_are_read(label, node, direction, sign):
    dof = Dof.parse(label)
    assert (dof.node, dof.direction, dof.sign) == (node, direction, sign)


@pytest.mark.parametrize(
    ("label", "hint"),
    [
        ("12:z", "did you mean '12:Z'?"),
        (" 12 : rx ", "did you mean '12:RX'?"),
        ("12:-z\n", "did you mean '12:-Z'?"),
        ("12", None),
        ("12:", None),
        ("12:W", None),
        ("12:RR", None),
        ("12.0:X", None),
        ("1e3:X", None),
        ("12:X:Y", None),
        ("--1:X", None),
        ("12:+-Z", None),
        ("", None),
        ("\u0661:X", None),  # a digit, but not one that a file should hold
    ],
)
def test_what_is_not_exactly_a_label_is_refused(label, hint):
    with raises(f"DOF {label!r}: expected node:direction") as caught:
        Dof.parse(label)
    assert ("did you mean" in str(caught.value)) == (hint is not None)
    if hint:
        assert hint in str(caught.value)


@pytest.mark.parametrize("label", [12, 1.5, None, ("1", "X")])
def test_a_label_is_a_text(label):
    with raises(f"DOF {label!r}: expected a text node:direction"):
        Dof.parse(label)


def test_parse_returns_a_dof_as_it_is():
    dof = Dof(1, "X")
    assert Dof.parse(dof) is dof


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ((1, "x"), "direction 'x' of node 1: expected one of X, Y, Z, RX, RY, RZ"),
        ((1, ["X"]), "direction ['X'] of node 1"),
        ((1, "X", 0), "sign 0 of DOF 1:X: expected 1 or -1"),
        ((1, "X", True), "sign True of DOF 1:X"),
        ((1.5, "X"), "node 1.5: expected a whole number"),
        (("1", "X"), "node '1': expected a whole number"),
        ((True, "X"), "node True: expected a whole number"),
        ((10**17 + 1, "X"), "expected at most 1e+17 in size"),
    ],
)
def test_a_dof_is_checked(arguments, text):
    with raises(text):
        Dof(*arguments)


def test_numpy_integers_become_plain():
    dof = Dof(np.int32(4), "X", np.int8(-1))
    assert type(dof.node) is int
    assert type(dof.sign) is int
    assert dof == Dof.parse("4:-X")


def test_the_sign_turns_around():
    assert -Dof(1, "RX") == Dof(1, "RX", -1)
    assert str(-Dof(1, "RX")) == "1:-RX"
    assert -Dof(1, "RX", -1) == Dof(1, "RX")


def test_a_dof_is_frozen_and_hashable():
    dof = Dof(1, "X")
    with pytest.raises(dataclasses.FrozenInstanceError):
        dof.node = 2
    assert {dof: "a"}[Dof(1, "X")] == "a"


# -- a set -------------------------------------------------------------------------------------------------
@pytest.fixture
def some() -> DofSet:
    return DofSet(["3:Z", "1:-X", "2:RY", "1:Y"])


def test_a_set_keeps_its_order(some):
    assert some.labels == ["3:Z", "1:-X", "2:RY", "1:Y"]
    assert [str(d) for d in some] == some.labels
    assert some.nodes.tolist() == [3, 1, 2, 1]
    assert some.axes.tolist() == [2, 0, 4, 1]
    assert some.signs.tolist() == [1, -1, 1, 1]


def test_a_set_is_a_sequence(some):
    assert len(some) == 4
    assert some[1] == Dof(1, "X", -1)
    assert some[-1] == Dof(1, "Y")
    assert some[np.int64(2)] == Dof(2, "RY")
    assert some[1:3].labels == ["1:-X", "2:RY"]
    assert some[[2, 0]].labels == ["2:RY", "3:Z"]
    assert some[np.array([True, False, False, True])].labels == ["3:Z", "1:Y"]
    assert some[[]].labels == []
    assert next(reversed(some)) == Dof(1, "Y")
    with pytest.raises(IndexError):
        some[4]


def test_membership_looks_at_node_and_direction(some):
    assert "1:X" in some
    assert Dof(1, "X", -1) in some
    assert "1:Z" not in some
    assert "rubbish" not in some
    assert 5 not in some
    assert "1:X" not in DofSet([])


def test_equality_looks_at_order_and_sign(some):
    assert some == DofSet(some.labels)
    assert some != DofSet(["3:Z", "1:X", "2:RY", "1:Y"])
    assert some != some[::-1]
    assert some != some.labels
    assert DofSet([]) == DofSet([])


def test_a_set_is_not_hashable(some):
    with pytest.raises(TypeError, match="unhashable"):
        hash(some)


def test_repr_shows_the_first_six(some):
    assert repr(some) == "DofSet([3:Z, 1:-X, 2:RY, 1:Y], n=4)"
    assert (
        repr(DofSet([f"{i}:X" for i in range(9)]))
        == "DofSet([0:X, 1:X, 2:X, 3:X, 4:X, 5:X, ...], n=9)"
    )


@pytest.mark.parametrize("again", ["1:X", "1:-X", Dof(1, "X")])
def test_a_dof_stands_once_with_either_sign(again):
    with raises(f"DOF {Dof.parse(again)} occurs twice: at positions 1 and 3"):
        DofSet([again, "2:X", "1:X"])


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ("1:X", "DOFs '1:X': expected a list of labels, found one text; write ['1:X']"),
        (5, "DOFs 5: expected a list of labels, found int"),
        ([5], "DOF 5: expected a text"),
        (["1:X", "2:Q"], "DOF '2:Q': expected node:direction"),
        ([f"{10**17 + 1}:X"], "expected a node of at most 1e+17 in size"),
    ],
)
def test_a_set_is_checked(given, text):
    with raises(text):
        DofSet(given)


def test_a_generator_will_do():
    assert DofSet(f"{i}:X" for i in range(3)).labels == ["0:X", "1:X", "2:X"]


def test_a_set_cannot_be_changed(some):
    with pytest.raises(AttributeError, match="'nodes' is read-only"):
        some.nodes = np.zeros(4)
    for array in (some.nodes, some.axes, some.signs):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_a_set_does_not_follow_the_arrays_it_came_from():
    nodes = np.array([1, 2])
    dofs = DofSet.from_arrays(nodes, np.array([0, 0]))
    nodes[0] = 9
    assert dofs.labels == ["1:X", "2:X"]


@pytest.mark.parametrize(
    "through",
    [lambda d: pickle.loads(pickle.dumps(d)), copy.deepcopy, copy.copy, DofSet],  # noqa: S301
)
def test_copies_are_equal_and_read_only(some, through):
    other = through(some)
    assert other == some
    assert not other.nodes.flags.writeable
    assert other.match(["2:RY"]).index.tolist() == [2]


# -- from arrays -------------------------------------------------------------------------------------------
def test_from_arrays():
    dofs = DofSet.from_arrays([4, 4, 5], [0, 5, 2], [1, -1, 1])
    assert dofs.labels == ["4:X", "4:-RZ", "5:Z"]
    assert DofSet.from_arrays([4.0], [0.0]).labels == ["4:X"]
    assert DofSet.from_arrays([], []).labels == []
    assert DofSet.from_arrays([7] * 6, range(6)).labels == [f"7:{d}" for d in DIRECTIONS]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (([1, 2], [0]), "expected equal lengths, found (2,), (1,), (2,)"),
        ((5, 0), "expected equal lengths, found (), (), ()"),
        (([[1]], [[0]]), "expected equal lengths, found (1, 1)"),
        (([1.5], [0]), "DOF nodes: expected whole numbers of at most 1e+17 in size, found 1.5"),
        (([np.nan], [0]), "found nan"),
        (([np.inf], [0]), "found inf"),
        (([-(2**63)], [0]), f"found {-(2**63)}"),
        ((["1"], [0]), "DOF nodes: expected whole numbers, found <U1"),
        (([True], [0]), "DOF nodes: expected whole numbers, found bool"),
        (([[1], [2, 3]], [0]), "DOF nodes: expected whole numbers in an array"),
        (([1], [6]), "DOF directions: expected 0..5 for X, Y, Z, RX, RY, RZ, found 6..6"),
        (([1, 2], [0, -1]), "found -1..0"),
        (([1], [256]), "found 256..256"),
        (([1], [0], [0]), "DOF signs: expected 1 or -1, found 0"),
        (([1, 1], [0, 0], [1, -1]), "DOF 1:X occurs twice: at positions 1 and 2"),
    ],
)
def test_from_arrays_is_checked(arguments, text):
    with raises(text):
        DofSet.from_arrays(*arguments)


def test_whole_numbers_raises_what_it_is_told():
    with pytest.raises(InputError, match="the things: expected whole numbers"):
        whole_numbers([0.5], "the things", InputError)


# -- match and complement ----------------------------------------------------------------------------------
def test_match_gives_position_and_sign(some):
    found = some.match(["1:X", "3:-Z", "1:-Y", "2:RY"])
    assert found.index.tolist() == [1, 0, 3, 2]
    assert found.sign.tolist() == [-1.0, -1.0, -1.0, 1.0]
    assert found.sign.dtype == np.float64
    assert some.match(["1:-X"]).sign.tolist() == [1.0]


def test_match_of_nothing(some):
    assert some.match([]).index.tolist() == []
    assert DofSet([]).match([]).index.tolist() == []


@pytest.mark.parametrize(
    ("wanted", "text"),
    [
        (["2:RX"], "response 2:RX is not among the 4 DOFs; nearest: 2:RY, 3:Z, 1:-X"),
        (
            ["9:-X", "1:Y", "8:X"],
            "response 9:-X is not among the 4 DOFs (2 such); nearest: 3:Z, 2:RY, 1:-X",
        ),
    ],
)
def test_match_names_the_nearest(some, wanted, text):
    with raises(text):
        some.match(wanted, "response")


def test_match_in_an_empty_set():
    with raises("DOF 1:X is not among the 0 DOFs; no choices exist"):
        DofSet([]).match(["1:X"])


def test_nodes_far_apart_do_not_collide():
    top = 10**17
    dofs = DofSet([f"{top}:RZ", f"{-top}:X", "0:X"])
    assert dofs.match([f"{-top}:X", f"{top}:RZ"]).index.tolist() == [1, 0]
    with raises(f"DOF {top}:X is not among the 3 DOFs; nearest: {top}:RZ, 0:X, {-top}:X"):
        dofs.match([f"{top}:X"])


@pytest.mark.parametrize("number", ["9" * 5000, "-" + "9" * 5000, "1" + "0" * 17 + "1"])
def test_nodes_beyond_all_files_are_refused(number):
    with raises("expected a node of at most 1e+17 in size"):
        DofSet([f"{number}:X"])
    with raises("DOF nodes: expected whole numbers"):
        DofSet.from_arrays([int(number[:4000])], [0])
    with raises("node: expected at most 1e+17 in size"):
        Dof(10**5000, "X")


def test_nodes_of_half_precision_are_read():
    assert DofSet.from_arrays(np.array([2.0, 7.0], dtype=np.float16), [0, 1]).labels == [
        "2:X",
        "7:Y",
    ]


def test_complement(some):
    assert some.complement(["2:RY", "1:X"]).tolist() == [0, 3]
    assert some.complement([]).tolist() == [0, 1, 2, 3]
    assert some.complement(some).tolist() == []
    with raises("DOF 7:X is not among the 4 DOFs"):
        some.complement(["7:X"])


# -- size --------------------------------------------------------------------------------------------------
def test_a_million_dofs():
    n = 10**6
    number = np.arange(n)
    dofs = DofSet.from_arrays(number // 6 + 1, number % 6)
    shuffled = np.random.default_rng(0).permutation(n)
    assert np.array_equal(dofs.match(dofs[shuffled]).index, shuffled)
    assert dofs.complement(dofs[6:]).tolist() == [0, 1, 2, 3, 4, 5]
    held = sum(getattr(dofs, name).nbytes for name in DofSet.__slots__)
    assert held <= 35 * n
    with raises("DOF 999999:X is not among the 1000000 DOFs; nearest: 166667:X"):
        dofs.match(["999999:X"])
