"""Groups and models: validation, warnings, sums, scaling, immutability."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import re
import warnings

import numpy as np
import pytest
import scipy.sparse as sp

from updyn.dofs import DofSet
from updyn.errors import DofError, ModelError, UpdynWarning
from updyn.geometry import Geometry
from updyn.model import Group, Model

SPRING = np.array([[1.0, -1.0], [-1.0, 1.0]])
TWO = ["1:X", "2:X"]


def raises(text: str, kind: type[Exception] = ModelError):
    return pytest.raises(kind, match=re.escape(text))


@pytest.fixture
def model() -> Model:
    return Model.from_groups(
        {
            "spring": Group(1e3 * SPRING, loss_factor=0.1),
            "masses": Group(mass=np.diag([2.0, 3.0])),
            "ground": Group(
                stiffness=np.diag([50.0, 0.0]), mass=np.diag([0.5, 0.0]), loss_factor=0.2
            ),
            "damper": Group(viscous=4.0 * SPRING),
        },
        TWO,
        geometry=Geometry([1, 2], np.zeros((2, 3))),
        title="two masses",
    )


# -- groups ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "kind", [np.array, sp.csr_array, sp.csc_matrix, sp.coo_array, sp.lil_array, np.ndarray.tolist]
)
def test_a_matrix_comes_in_any_form(kind):
    group = Group(kind(7.0 * SPRING))
    assert isinstance(group.stiffness, sp.csr_array)
    assert group.stiffness.dtype == np.float64
    assert group.stiffness.has_canonical_format
    assert group.stiffness.toarray().tolist() == [[7.0, -7.0], [-7.0, 7.0]]
    assert group.n_dofs == 2
    assert (group.mass, group.viscous, group.loss_factor) == (None, None, 0.0)


def test_whole_numbers_and_duplicates_are_summed_up():
    twice = sp.coo_array(([1, 2, 3], ([0, 0, 1], [0, 0, 1])), shape=(2, 2))
    assert Group(twice).stiffness.toarray().tolist() == [[3.0, 0.0], [0.0, 3.0]]


@pytest.mark.parametrize(
    ("matrix", "text"),
    [
        (np.ones((2, 3)), "stiffness: expected a square matrix, found shape (2, 3)"),
        (5.0, "stiffness: expected a square matrix, found shape ()"),
        ([5.0], "stiffness: expected a square matrix, found shape (1,)"),
        (np.zeros((0, 0)), "stiffness: expected a square matrix, found shape (0, 0)"),
        (np.zeros((2, 2, 2)), "stiffness: expected a square matrix, found shape (2, 2, 2)"),
        (sp.csr_array(np.ones((2, 3))), "stiffness: expected a square matrix, found shape (2, 3)"),
        ([[1, 2], [3]], "stiffness: not a matrix of numbers"),
        ([["a"]], "stiffness: expected a matrix of numbers, found <U1"),
        ([[True]], "stiffness: expected a matrix of numbers, found bool"),
        (np.ma.masked_equal([[1.0]], 1.0), "stiffness: holds masked values"),
        ([[1, np.nan], [np.nan, 1]], "stiffness: row 1 holds a number that is not finite"),
        ([[1, 0], [0, np.inf]], "stiffness: row 2 holds a number that is not finite"),
        ([[1 + 0j]], "stiffness: found complex numbers; damping goes into loss_factor and viscous"),
        (
            sp.csr_array([[1 + 1j]]),
            "stiffness: found complex numbers; damping goes into loss_factor and viscous",
        ),
        ([[1, 2.5], [2, 1]], "stiffness is not symmetric: entry (1, 2) is 2.5, (2, 1) is 2"),
    ],
)
def test_a_matrix_is_checked(matrix, text):
    with raises(text):
        Group(matrix)
    with raises(text.replace("stiffness", "viscous", 1)):
        Group(viscous=matrix)


def test_asymmetry_by_rounding_is_evened_out():
    K = 1e6 * SPRING
    K[0, 1] *= 1 + 1e-12
    held = Group(K).stiffness.toarray()
    assert held[0, 1] == held[1, 0]
    assert held[0, 1] == pytest.approx(-1e6 * (1 + 0.5e-12), rel=1e-15)
    K[0, 1] = -1e6 * (1 + 1e-9)
    with raises("stiffness is not symmetric: entry (1, 2) is -1e+06, (2, 1) is -1e+06"):
        Group(K)


@pytest.mark.parametrize(("skew", "is_accepted"), [(0.9e-10, True), (1.1e-10, False)])
def test_asymmetry_up_to_1e_10_of_the_largest_entry(skew, is_accepted):
    K = np.diag([2.0, 1.0])
    K[0, 1] = 2.0 * skew
    if is_accepted:
        assert Group(K).stiffness.nnz == 4
        return
    with raises("stiffness is not symmetric"):
        Group(K)


def test_the_sizes_of_a_group_agree():
    with raises("the matrices of a group differ in size: {'stiffness': 2, 'mass': 3}"):
        Group(SPRING, np.eye(3))


def test_a_group_holds_something():
    with raises("a group needs at least one of stiffness, mass and viscous"):
        Group(loss_factor=0.1)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (-0.1, "loss factor -0.1: expected a finite number of at least 0"),
        (np.nan, "loss factor nan: expected a finite number"),
        (np.inf, "loss factor inf: expected a finite number"),
        ("0.1", "loss factor '0.1': expected a number"),
        (True, "loss factor True: expected a number"),
        (0.1j, "loss factor 0.1j: expected a number"),
        (None, "loss factor None: expected a number"),
    ],
)
def test_a_loss_factor_is_checked(value, text):
    with raises(text):
        Group(SPRING, loss_factor=value)


def test_a_group_cannot_be_changed_and_does_not_follow_what_it_came_from():
    given = sp.csr_array(SPRING)
    group = Group(given)
    given.data[:] = 9.0
    assert group.stiffness.toarray().tolist() == SPRING.tolist()
    with pytest.raises(dataclasses.FrozenInstanceError):
        group.loss_factor = 0.5
    for array in (group.stiffness.data, group.stiffness.indices, group.stiffness.indptr):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_repr_of_a_group_is_short():
    assert (
        repr(Group(SPRING, viscous=SPRING, loss_factor=0.05))
        == "Group(stiffness, viscous; 2 DOFs, loss factor 0.05)"
    )


# -- models ------------------------------------------------------------------------------------------------
def test_the_sums(model):
    assert model.n_dofs == 2
    assert model.stiffness.toarray().tolist() == [[1050.0, -1000.0], [-1000.0, 1000.0]]
    assert model.mass.toarray().tolist() == [[2.5, 0.0], [0.0, 3.0]]
    assert model.viscous.toarray().tolist() == [[4.0, -4.0], [-4.0, 4.0]]
    assert model.structural.toarray().tolist() == [[110.0, -100.0], [-100.0, 100.0]]
    assert repr(model) == "Model(2 DOFs, 4 groups: spring, masses, ground, damper)"


def test_a_sum_of_nothing_is_zero():
    only = Model.from_groups({"k": Group(np.eye(2))}, TWO)
    for matrix in (only.mass, only.viscous, only.structural):
        assert matrix.shape == (2, 2)
        assert matrix.nnz == 0


@pytest.mark.parametrize("n", [1, 2, 3, 5, 8])
def test_the_sum_holds_every_group_once(n):
    groups = {f"g{i}": Group(2.0**i * np.eye(2)) for i in range(n)}
    total = Model.from_groups(groups, TWO).stiffness
    assert total.toarray().tolist() == ((2.0**n - 1) * np.eye(2)).tolist()


def test_sums_cannot_be_changed(model):
    for matrix in (model.stiffness, model.mass, model.viscous, model.structural):
        with pytest.raises(ValueError, match="read-only"):
            matrix.data[0] = 1.0


def test_the_gear_train_of_the_paper(gear_train, gear_train_case):
    """Natural frequencies stand in the case file, computed apart; the paper prints M and K near these."""
    K, M = gear_train.stiffness.toarray(), gear_train.mass.toarray()
    w = np.sqrt(np.abs(np.sort(np.real(np.linalg.eigvals(np.linalg.solve(M, K))))))
    np.testing.assert_allclose(
        w, gear_train_case["natural_frequencies_true_rad_s_undamped"], rtol=2e-5
    )
    printed = gear_train_case["paper_result_after_5_iterations"]
    np.testing.assert_allclose(
        np.diag(M)[[3, 4]], np.array(printed["M_diagonal"])[[3, 4]], rtol=5e-5
    )
    np.testing.assert_allclose(
        np.diag(K)[[0, 2, 3, 4]], 1e6 * np.array(printed["K_diagonal_1e6"])[[0, 2, 3, 4]], rtol=5e-5
    )


def test_the_gear_train_answers_as_computed_with_60_digits(gear_train, gear_train_reference):
    K, M, D = (m.toarray() for m in (gear_train.stiffness, gear_train.mass, gear_train.structural))
    for omega, column in gear_train_reference["receptance"].items():
        Z = K + 1j * D - float(omega) ** 2 * M
        expected = np.array(column) @ [1, 1j]
        np.testing.assert_allclose(np.linalg.solve(Z, np.eye(7)[:, 1]), expected, rtol=1e-8, atol=0)


@pytest.mark.parametrize(
    ("groups", "dofs", "kind", "text"),
    [
        ({}, TWO, ModelError, "a model needs at least one group"),
        (
            [Group(SPRING)],
            TWO,
            ModelError,
            "groups: expected a mapping of name to Group, found list",
        ),
        ({"a": SPRING}, TWO, ModelError, "group 'a': expected a Group, found ndarray"),
        ({"a": Group(SPRING)}, ["1:X"], ModelError, "group 'a' has 2 DOFs, the model has 1 labels"),
        (
            {"a": Group(SPRING)},
            ["1:X", "2:-X"],
            ModelError,
            "DOF 2:-X: the DOFs of a model are positive",
        ),
        ({"a": Group(SPRING)}, ["1:X", "1:X"], DofError, "DOF 1:X occurs twice"),
        ({"a": Group(SPRING)}, ["1:X", "2"], DofError, "DOF '2': expected node:direction"),
        (
            {"": Group(SPRING)},
            TWO,
            ModelError,
            "group name '': expected a text without blanks at its ends",
        ),
        (
            {" a": Group(SPRING)},
            TWO,
            ModelError,
            "group name ' a': expected a text without blanks at its ends",
        ),
        ({1: Group(SPRING)}, TWO, ModelError, "group name 1: expected a text"),
        (
            {"a.b": Group(SPRING)},
            TWO,
            ModelError,
            "group name 'a.b' holds '.': unknowns are called name.quantity",
        ),
        ({"a*": Group(SPRING)}, TWO, ModelError, "group name 'a*' holds '*'"),
    ],
)
def test_a_model_is_checked(groups, dofs, kind, text):
    with raises(text, kind):
        Model.from_groups(groups, dofs)
    with raises(text, kind):
        Model(groups, dofs)


def test_a_dof_without_anything_is_refused():
    K = np.zeros((4, 4))
    K[0, 0] = 1.0
    stored_zero = sp.coo_array(([1.0, 0.0], ([0, 2], [0, 2])), shape=(4, 4))
    for matrix in (K, stored_zero):
        with raises(
            "DOF 2:X has neither stiffness, mass nor damping (3 such): the model is singular"
        ):
            Model.from_groups({"a": Group(matrix)}, [f"{i}:X" for i in range(1, 5)])


def test_massless_dofs_free_structures_and_pure_dampers_are_normal():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Model.from_groups({"spring": Group(SPRING), "mass": Group(mass=np.diag([1.0, 0.0]))}, TWO)
        Model.from_groups({"spring": Group(SPRING, np.eye(2))}, TWO)
        Model.from_groups({"damper": Group(viscous=SPRING)}, TWO)


# -- indefinite groups -------------------------------------------------------------------------------------
def test_the_rounded_table_of_the_paper_is_named_and_accepted(gear_train_groups):
    with pytest.warns(UpdynWarning, match="group 'unit 2': stiffness is indefinite") as caught:
        model = Model.from_groups(gear_train_groups, [f"{i}:RZ" for i in range(1, 8)])
    assert len(caught) == 1
    # det = -3.4e-4 over trace = 11.09, in units of 1e6: the smaller eigenvalue
    assert "smallest eigenvalue -31, largest 1.11e+07" in str(caught[0].message)
    assert caught[0].filename == __file__
    assert model.groups["unit 2"].stiffness.nnz == 4


@pytest.mark.parametrize("what", ["stiffness", "mass", "viscous"])
def test_a_wrong_sign_is_named(what):
    with pytest.warns(UpdynWarning, match=f"group 'a': {what} is indefinite"):
        Model.from_groups({"a": Group(**{what: -SPRING})}, TWO)


def chain(n: int) -> sp.csr_array:
    """A free chain of equal springs: semidefinite, and its smallest eigenvalue is 0."""
    K = sp.diags_array(
        [2.0 * np.ones(n), -np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1, -1]
    ).tolil()
    K[0, 0] = K[n - 1, n - 1] = 1.0
    return K.tocsr()


@pytest.mark.parametrize("n", [600, 601, 2000])
def test_a_semidefinite_group_is_no_cause_for_a_warning(n):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Model.from_groups({"a": Group(1e7 * chain(n))}, [f"{i}:X" for i in range(n)])


@pytest.mark.parametrize(
    ("row", "column", "value", "text"),
    [
        (700, 700, -2.0, "diagonal entry 701 is -2"),
        (700, 701, 3.0, "entry (701, 702) outweighs its diagonal entries"),
    ],
)
def test_a_wrong_entry_of_a_large_group_is_located(row, column, value, text):
    K = chain(1000).tolil()
    K[row, column] = K[column, row] = value
    with pytest.warns(UpdynWarning, match=re.escape(text)):
        Model.from_groups({"a": Group(K)}, [f"{i}:X" for i in range(1000)])


def test_a_small_wrong_entry_beside_large_sound_ones_is_found():
    """Rounding in the stiff part exceeds, in size, the wrong entry of the soft part."""
    n = 1000
    K = chain(n).tolil()
    K[0, 0] = K[1, 1] = 1e8
    K[0, 1] = K[1, 0] = -1e8 * (1 + 1e-14)
    K[900, 901] = K[901, 900] = -2.1
    with pytest.warns(UpdynWarning, match=re.escape("entry (901, 902) outweighs")):
        Model.from_groups({"a": Group(K)}, [f"{i}:X" for i in range(n)])


# -- a group by name ---------------------------------------------------------------------------------------
def test_group_by_name(model):
    assert model.group("spring") is model.groups["spring"]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("sprnig", "no group 'sprnig'; did you mean 'spring'?"),
        ("xyz", "no group 'xyz'; valid: 'spring', 'masses', 'ground', 'damper'"),
        (5, "no group 5; valid:"),
        (["spring"], "no group ['spring']; did you mean 'spring'?"),
    ],
)
def test_an_unknown_group_names_the_nearest(model, name, text):
    with raises(text):
        model.group(name)


# -- scaled ------------------------------------------------------------------------------------------------
def test_factors_and_values(model):
    got = model.scaled(
        {
            "ground": {"stiffness": 3.0, "mass": 2.0},
            "spring": {"loss_factor": 0.5, "stiffness": 2.0},
            "damper": {"viscous": 0.25},
        }
    )
    assert got.stiffness.toarray().tolist() == [[2150.0, -2000.0], [-2000.0, 2000.0]]
    assert got.mass.toarray().tolist() == [[3.0, 0.0], [0.0, 3.0]]
    assert got.viscous.toarray().tolist() == [[1.0, -1.0], [-1.0, 1.0]]
    # loss factors stand on the changed stiffness: 0.5 * 2000 and 0.2 * 150
    assert got.structural.toarray().tolist() == [[1030.0, -1000.0], [-1000.0, 1000.0]]
    assert (got.title, got.dofs, got.geometry) == (model.title, model.dofs, model.geometry)


def test_a_factor_on_stiffness_scales_its_damping_too(model):
    got = model.scaled({"spring": {"stiffness": 3.0}})
    assert got.group("spring").loss_factor == 0.1
    before = model.group("spring").stiffness.toarray() * 0.1
    after = (got.structural - model.structural).toarray() + before
    np.testing.assert_allclose(after, 3.0 * before, rtol=1e-14)


def test_the_model_that_was_scaled_is_as_before(model):
    model.scaled({"spring": {"stiffness": 3.0}})
    assert model.stiffness.toarray().tolist() == [[1050.0, -1000.0], [-1000.0, 1000.0]]


def test_what_does_not_change_is_shared(model):
    got = model.scaled({"ground": {"stiffness": 3.0, "mass": 1.0}})
    assert got.group("spring") is model.group("spring")
    assert got.group("ground").mass is model.group("ground").mass
    assert np.shares_memory(
        got.group("ground").stiffness.indices, model.group("ground").stiffness.indices
    )
    assert not got.group("ground").stiffness.data.flags.writeable


def test_a_factor_of_0_keeps_the_pattern(model):
    got = model.scaled({"spring": {"stiffness": 0}})
    assert got.group("spring").stiffness.nnz == 4
    assert got.stiffness.toarray().tolist() == [[50.0, 0.0], [0.0, 0.0]]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"sprin": {}}, "no group 'sprin'; did you mean 'spring'?"),
        (
            {"spring": {"stifness": 1.0}},
            (
                "group 'spring': no quantity 'stifness'; did you mean 'stiffness' or"
                " 'stiffness_damping'?"
            ),
        ),
        ({"spring": {"mass": 1.0}}, "group 'spring' has no mass to change"),
        ({"masses": {"loss_factor": 0.1}}, "group 'masses' has no stiffness to change"),
        ({"spring": {"viscous": 1.0}}, "group 'spring' has no viscous to change"),
        ({"spring": {"stiffness": np.nan}}, "group 'spring': stiffness nan is not finite"),
        ({"spring": {"stiffness": "2"}}, "group 'spring': stiffness '2': expected a number"),
        ({"spring": {"stiffness": None}}, "group 'spring': stiffness None: expected a number"),
        ({"spring": {"stiffness": True}}, "group 'spring': stiffness True: expected a number"),
        (
            {"spring": {"loss_factor": -0.1}},
            "loss factor -0.1: expected a finite number of at least 0",
        ),
        ({"spring": 2.0}, "group 'spring': expected a mapping of quantity to number, found 2.0"),
        (2.0, "changes: expected a mapping of group to quantities, found float"),
    ],
)
def test_changes_are_checked(model, changes, text):
    with raises(text):
        model.scaled(changes)


# -- immutable ---------------------------------------------------------------------------------------------
# -- with_element ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("dofs", "between", "wanted"),
    [
        (["2:X"], False, [[0.0, 0.0], [0.0, 7.0]]),
        (["1:X", "2:X"], False, [[7.0, 0.0], [0.0, 7.0]]),
        (["1:X", "2:X"], True, [[7.0, -7.0], [-7.0, 7.0]]),
        (["1:X", "2:-X"], True, [[7.0, 7.0], [7.0, 7.0]]),
    ],
)
@pytest.mark.parametrize("quantity", ["stiffness", "viscous", "mass"])
def test_an_element_is_added_as_a_group(model, dofs, between, wanted, quantity):
    more = model.with_element("more", dofs, between=between, **{quantity: 7.0})
    added = (getattr(more, quantity) - getattr(model, quantity)).toarray()
    np.testing.assert_allclose(added, wanted, atol=1e-12)
    assert list(more.groups) == [*model.groups, "more"]
    assert more.geometry is model.geometry
    assert getattr(more.group("more"), quantity) is not None


def test_a_spring_with_loss_and_a_dashpot_are_one_element(model):
    more = model.with_element("mount", ["1:X"], stiffness=2.0, viscous=3.0, loss_factor=0.5)
    group = more.group("mount")
    assert (group.stiffness[0, 0], group.viscous[0, 0], group.loss_factor) == (2.0, 3.0, 0.5)
    assert group.mass is None


@pytest.mark.parametrize(
    ("name", "dofs", "options", "text"),
    [
        ("spring", ["1:X"], {"mass": 1.0}, "group 'spring' exists; expected a new name"),
        ("more.", ["1:X"], {"mass": 1.0}, "group name 'more.' holds '.'"),
        ("more", ["1:X"], {}, "expected a stiffness, viscous or mass above 0; all are 0"),
        ("more", ["1:X"], {"mass": -1.0}, "mass -1.0: expected a finite number of at least 0"),
        ("more", ["1:X"], {"viscous": np.inf}, "viscous inf: expected a finite number"),
        ("more", ["1:X"], {"mass": "1"}, "mass '1': expected a finite number"),
        ("more", [], {"mass": 1.0}, "expected at least one degree of freedom, found none"),
        (
            "more",
            ["1:X"],
            {"mass": 1.0, "between": True},
            "expected two degrees of freedom, found 1",
        ),
    ],
)
def test_an_element_is_checked(model, name, dofs, options, text):
    with raises(text):
        model.with_element(name, dofs, **options)


def test_an_element_at_an_unknown_dof_names_the_nearest(model):
    with raises("DOF 3:X is not among the 2 DOFs", DofError):
        model.with_element("more", ["3:X"], mass=1.0)


def test_a_model_cannot_be_changed(model):
    with pytest.raises(dataclasses.FrozenInstanceError):
        model.title = "x"
    with pytest.raises(TypeError):
        model.groups["new"] = Group(SPRING)


def test_a_model_does_not_follow_the_mapping_it_came_from():
    groups = {"a": Group(SPRING, np.eye(2))}
    built = [Model(groups, TWO), Model.from_groups(groups, TWO)]
    groups["b"] = Group(SPRING)
    assert [list(m.groups) for m in built] == [["a"], ["a"]]


def test_labels_become_a_dof_set():
    assert Model({"a": Group(SPRING)}, TWO).dofs == DofSet(TWO)


@pytest.mark.parametrize("through", [lambda m: pickle.loads(pickle.dumps(m)), copy.deepcopy])  # noqa: S301
def test_copies_are_equal_and_read_only(model, through):
    other = through(model)
    assert list(other.groups) == list(model.groups)
    for name, group in model.groups.items():
        twin = other.groups[name]
        assert twin.loss_factor == group.loss_factor
        for what in ("stiffness", "mass", "viscous"):
            a, b = getattr(group, what), getattr(twin, what)
            assert (a is None) == (b is None)
            if a is not None:
                assert np.array_equal(a.toarray(), b.toarray())
                assert not b.data.flags.writeable
    assert (other.dofs, other.title) == (model.dofs, model.title)
    assert other.geometry.nodes.tolist() == [1, 2]


def test_a_number_beyond_all_doubles_is_refused():
    with pytest.raises(ModelError, match="expected a number"):
        Group(np.eye(2), loss_factor=10**400)


def test_a_whole_number_beyond_64_bits_is_a_number(model):
    changed = model.scaled({"spring": {"stiffness": 10**30}})
    np.testing.assert_allclose(
        changed.groups["spring"].stiffness.toarray(),
        1e30 * model.groups["spring"].stiffness.toarray(),
    )
    assert Group(np.eye(2), loss_factor=10**30).loss_factor == 1e30


@pytest.mark.parametrize("quantity", ["loss_factor", "stiffness_damping"])
def test_damping_of_a_stiffness_that_is_not_there_is_refused(quantity):
    with pytest.raises(ModelError, match=f"{quantity} 0.02: the group has no stiffness"):
        Group(mass=np.eye(2), **{quantity: 0.02})
    assert getattr(Group(mass=np.eye(2)), quantity) == 0.0
