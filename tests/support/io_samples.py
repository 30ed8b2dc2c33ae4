"""A small model with every kind of part, FRFs, and exact comparison, for the tests of the formats."""

import numpy as np
import scipy.sparse as sp

from updyn.frf import FRF
from updyn.geometry import Geometry
from updyn.model import Group, Model

THIRD = 1.0 / 3.0


def geometry() -> Geometry:
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return Geometry(
        [1, 7, -3],
        [[0.0, 0.1, THIRD], [1e-300, -2.5, 1e17], [1, 2, 3]],
        [[1, 7], [7, -3]],
        [turned] * 3,
        [[1, 7, -3, -3]],
    )


def model(with_geometry: bool = True) -> Model:
    """Three DOFs; a full group, one with viscous damping, one with mass only; numbers without short decimals."""
    K = np.array([[2.0e8, -THIRD, 0.0], [-THIRD, np.pi * 1e8, -1e-7], [0.0, -1e-7, 3.0]])
    M = sp.csr_array(([1.0, 0.1, np.nextafter(1.0, 2.0)], [0, 1, 2], [0, 1, 2, 3]), shape=(3, 3))
    C = sp.csr_array(([0.7, 0.0], [1, 2], [0, 0, 1, 2]), shape=(3, 3))  # with an explicit zero
    groups = {
        "shaft": Group(K, M, loss_factor=0.1 / 3),
        "gear 1/é": Group(sp.csr_array(([5e6], [0], [0, 1, 1, 1]), shape=(3, 3)), viscous=C),
        "a_first": Group(mass=np.diag([0.0, 2.0, 0.0])),
    }
    place = geometry() if with_geometry else None
    return Model.from_groups(
        groups, ["7:RZ", "1:X", "1:Y"], geometry=place, title='Drive "A", Prüfstand\n2'
    )


def frf(n_references: int = 2, with_geometry: bool = True) -> FRF:
    rng = np.random.default_rng(3)
    shape = (5, 3, n_references)
    values = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    return FRF(
        np.array([0.0, 0.1, 0.3, 1.0 / 3.0 + 0.1, 17.0]),
        values,
        ["1:X", "2:-Y", "3:RZ"],
        ["7:RZ", "1:-X"][:n_references],
        "mobility",
        coherence=rng.uniform(size=shape),
        variance=rng.uniform(size=shape) * 1e-9,
        averages=7,
        geometry=geometry() if with_geometry else None,
        source="bench, run 3",
    )


def assert_same_geometry(found: Geometry | None, expected: Geometry | None) -> None:
    assert (found is None) == (expected is None)
    if expected is None:
        return
    for name in ("nodes", "xyz", "lines", "axes", "faces"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), strict=True)


def assert_same_model(found: Model, expected: Model) -> None:
    """Equal to the last bit, entries that are zero included."""
    assert list(found.groups) == list(expected.groups)
    assert found.dofs == expected.dofs
    assert found.title == expected.title
    assert_same_geometry(found.geometry, expected.geometry)
    for name, group in expected.groups.items():
        other = found.groups[name]
        assert other.loss_factor == group.loss_factor
        for what in ("stiffness", "mass", "viscous"):
            a, b = getattr(other, what), getattr(group, what)
            assert (a is None) == (b is None), (name, what)
            if b is not None:
                assert a.shape == b.shape
                assert a.data.tobytes() == b.data.tobytes(), (name, what)
                np.testing.assert_array_equal(a.indices, b.indices)
                np.testing.assert_array_equal(a.indptr, b.indptr)


def assert_same_frf(found: FRF, expected: FRF) -> None:
    assert found.responses == expected.responses
    assert found.references == expected.references
    for name in ("quantity", "averages", "source"):
        assert getattr(found, name) == getattr(expected, name)
    for name in ("freq", "values", "coherence", "variance"):
        a, b = getattr(found, name), getattr(expected, name)
        assert (a is None) == (b is None), name
        if b is not None:
            assert a.tobytes() == b.tobytes(), name
    assert_same_geometry(found.geometry, expected.geometry)
