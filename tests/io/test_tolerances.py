"""Tolerances of readers, by numbers just inside and just outside of each."""

from __future__ import annotations

import warnings
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.sparse as sp

from updyn.errors import FormatError
from updyn.geometry import Geometry
from updyn.io import lvm, text_numbers
from updyn.io.abaqus import matrices
from updyn.io.nastran import assembly, assembly_elements, dmig, op2
from updyn.io.uff import frf, functions, labels, modes

PLACE = SimpleNamespace(error=lambda text: FormatError(text, "file"))


def is_refused(check, *arguments):
    try:
        check(*arguments)
    except FormatError:
        return True
    return False


def test_numbers_from_1e_30_to_1e30_are_usual():
    table = np.array([0.0, 0.9e-30, 1.1e-30, 0.9e30, 1.1e30])
    assert functions._fraction_unusual(table) == 0.5


@pytest.mark.parametrize(("share", "is_checked"), [(0.09, False), (0.11, True)])
def test_byte_order_is_checked_from_a_tenth_of_unusual_numbers(share, is_checked):
    table = np.where(np.arange(100) < 100 * share, 1e35, 1.0)
    payload = SimpleNamespace(read=lambda **_: np.ones(100))
    assert is_refused(functions._check_byte_order, payload, table, "file", 1) is is_checked


@pytest.mark.parametrize(("frequency", "is_warned"), [(0.9e-3, False), (1.1e-3, True)])
def test_negative_eigenvalues_of_rigid_body_modes(frequency, is_warned):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        op2._frequencies(np.array([-(frequency**2), 1.0]), "file")
    assert bool(caught) is is_warned


@pytest.mark.parametrize(("change", "belongs"), [(0.9e-5, True), (1.1e-5, False)])
def test_eigenvalues_of_one_mode_in_two_tables(change, belongs):
    row = {op2._LAMA_EIGENVALUE: 1.0 + change}
    assert op2._belongs_to({1: row}, [SimpleNamespace(number=1, value=1.0 + 0j)]) is belongs


@pytest.mark.parametrize(("change", "refused"), [(0.019, False), (0.021, True)])
def test_eigenvalue_of_a_normal_mode(change, refused):
    square = (2.0 * np.pi) ** 2 * (1.0 + change)
    assert is_refused(modes._check_eigenvalue, 1.0, square, PLACE) is refused


@pytest.mark.parametrize(("change", "refused"), [(0.009, False), (0.011, True)])
def test_frequency_of_a_complex_mode(change, refused):
    fields = np.array([1.0, 1.0 + change, 1.0, 0.0, 0.0, 0.0])
    assert is_refused(modes._check_fields, fields, 2j * np.pi, PLACE) is refused


@pytest.mark.parametrize(("change", "refused"), [(2.9e-3, False), (3.1e-3, True)])
def test_damping_of_a_complex_mode(change, refused):
    """A thousandth, and two percent of a ratio of 0.1."""
    s = 2.0 * np.pi * complex(-0.1, np.sqrt(0.99))
    fields = np.array([1.0, 1.0, 1.0, 0.0, 0.1 + change, 0.0])
    assert is_refused(modes._check_fields, fields, s, PLACE) is refused


@pytest.mark.parametrize(("change", "is_same"), [(0.9e-3, True), (1.1e-3, False)])
def test_factors_of_units(change, is_same):
    assert labels._is_same(1.0 + change, 1.0) is is_same


@pytest.mark.parametrize(("change", "is_rounding"), [(0.04, True), (0.06, False)])
def test_times_of_ten_steps_are_rounded_by_half_a_step(change, is_rounding):
    times = np.array([np.linspace(0.0, 10.0 * (1.0 + change), 11)])
    found = lvm._step(times, SimpleNamespace(step=1.0))
    assert (found == 1.0) is is_rounding


@pytest.mark.parametrize(("change", "refused"), [(0.9e-8, False), (1.1e-8, True)])
def test_structural_damping_is_a_multiple_of_the_stiffness(change, refused):
    K = sp.csr_array(np.diag([1.0, 1e-6]))
    D = sp.csr_array(np.diag([1.0, 1e-6 + change]))
    part = SimpleNamespace(name="a")
    assert is_refused(matrices._find_loss_factor, D, K, part, "file") is refused


@pytest.mark.parametrize(("shift", "refused"), [(0.9e-3, False), (1.1e-3, True)])
def test_start_times_of_channels_differ_by_a_thousandth_of_a_step(shift, refused):
    tags = lvm._Tags({"X0": ["1.0", str(1.0 + 0.1 * shift)]}, (0, 1), "file", 1)
    assert is_refused(tags.check_start, 0.1, ".") is refused


@pytest.mark.parametrize(("change", "is_isotropic"), [(0.009, True), (0.011, False)])
def test_a_shear_modulus_is_isotropic_within_a_hundredth(change, is_isotropic):
    E, nu = 2e11, 0.25
    G = E / (2 * (1 + nu)) / (1 + change)
    assert assembly_elements._has_isotropic_shear(E, nu, G) is is_isotropic


@pytest.mark.parametrize(("stiffness", "is_singular"), [(0.9e-8, True), (1.1e-8, False)])
def test_a_degree_of_freedom_without_stiffness(stiffness, is_singular):
    grid = SimpleNamespace(size=3, list_axes=lambda: np.array([[0, 1, 2]]))
    K = sp.csr_array(np.diag([2.0, 1.0, 2.0 * stiffness]))
    found = assembly._find_singular(K, np.zeros(3, dtype=bool), grid)
    assert found.tolist() == [False, False, is_singular]


@pytest.mark.parametrize(("change", "contradicts"), [(1.9e-3, False), (2.1e-3, True)])
def test_modal_b_is_that_of_modal_a_within_two_thousandths(change, contradicts):
    place = SimpleNamespace(error=PLACE.error, stated=())
    s, a = 2.0 * np.pi * complex(-0.01, 10.0), 3.0
    b = -s * a / (1.0 - change)
    numbers = np.array([s.real, s.imag, a, 0.0, b.real, b.imag])
    assert modes._complex_mode_properties(numbers, place).is_contradictory is contradicts


@pytest.mark.parametrize(("angle", "refused"), [(0.9e-6, False), (1.1e-6, True)])
def test_directions_of_nodes_are_parallel_to_an_axis_to_a_millionth(angle, refused):
    cos, sin = np.cos(angle), np.sin(angle)
    axes = np.array([[[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]])
    places = frf.Directions("file", None, Geometry([1], np.zeros((1, 3)), axes=axes))
    assert is_refused(places.dof, "response", 1, 1, 1) is refused


@pytest.mark.parametrize(("mirrored", "refused"), [("99999.91", False), ("99999.89", True)])
def test_mirrored_entries_are_equal_to_a_millionth(tmp_path, mirrored, refused):
    path = tmp_path / "k.pch"
    path.write_text(
        f"DMIG,K,0,6,2,0\nDMIG,K,1,1,,1,2,100000.\nDMIG,K,1,2,,1,1,{mirrored}\n", encoding="utf-8"
    )
    assert is_refused(dmig.read_dmig, path) is refused


def test_a_message_quotes_sixty_characters():
    with pytest.raises(ValueError, match=f"^'{'x' * 60}' is not a number"):
        text_numbers.parse_real("x" * 100)
