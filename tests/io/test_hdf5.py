"""The native model file: exact round trip, its layout, and what is refused."""

import h5py
import numpy as np
import pytest
import scipy.sparse as sp

from io_samples import assert_same_model, model
from updyn.errors import FormatError, UpdynWarning
from updyn.io.hdf5 import read_model, write_model
from updyn.model import Group, Model


@pytest.mark.parametrize("with_geometry", [True, False])
def test_round_trip_is_exact(tmp_path, with_geometry):
    expected = model(with_geometry)
    write_model(expected, tmp_path / "m.h5")
    assert_same_model(read_model(tmp_path / "m.h5"), expected)


def test_round_trip_of_large_sparse_groups_is_exact(tmp_path):
    """Large enough to be stored compressed; more groups than ten, so that order by name would differ."""
    n, rng = 3000, np.random.default_rng(1)
    off = rng.normal(size=n - 1)
    tri = sp.diags_array([off, 10.0 + rng.uniform(size=n), off], offsets=[-1, 0, 1])
    groups = {
        f"part {i}": Group(tri * (1.0 / (3 + i)), loss_factor=0.01 * i) for i in range(12, 0, -1)
    }
    expected = Model.from_groups(groups, [f"{i}:Z" for i in range(1, n + 1)])
    write_model(expected, tmp_path / "m.h5")
    assert_same_model(read_model(tmp_path / "m.h5"), expected)


def test_layout_can_be_read_without_updyn(tmp_path):
    expected = model()
    write_model(expected, tmp_path / "m.h5")
    with h5py.File(tmp_path / "m.h5") as file:
        assert file.attrs["updyn_kind"] == b"model"
        assert file.attrs["updyn_format"] == 1
        assert file["dofs/node"][()].tolist() == [7, 1, 1]
        assert file["dofs/direction"][()].tolist() == [b"RZ", b"X", b"Y"]
        assert [file[f"groups/{i:04d}"].attrs["name"].decode() for i in range(3)] == [
            "shaft",
            "gear 1/é",
            "a_first",
        ]
        place = file["groups/0000/stiffness"]
        parts = tuple(place[name][()] for name in ("data", "indices", "indptr"))
        upper = sp.csr_array(parts, shape=(3, 3)).toarray()
    np.testing.assert_array_equal(upper, np.triu(expected.groups["shaft"].stiffness.toarray()))


def test_matrices_shared_by_two_models_are_stored_once(tmp_path):
    from updyn.foreign.hdf5 import load
    from updyn.io.hdf5 import Folder, put_model, take_model

    start = model()
    changed = start.scaled({"shaft": {"stiffness": 1.1}})
    stored = {}
    with h5py.File(tmp_path / "two.h5", "w") as file:
        put_model(file.create_group("a"), start, stored)
        put_model(file.create_group("b"), changed, stored)
        assert file["a/groups/0001/stiffness"] == file["b/groups/0001/stiffness"]
        assert file["a/groups/0000/stiffness"] != file["b/groups/0000/stiffness"]
    root = Folder.of("/", load(str(tmp_path / "two.h5"), False))
    assert_same_model(take_model(root.members["b"], "two.h5"), changed)


def test_reading_warns_about_an_indefinite_group(tmp_path):
    with pytest.warns(UpdynWarning, match="indefinite"):
        bad = Model.from_groups({"a": Group(np.diag([1.0, -1.0]), np.eye(2))}, ["1:X", "2:X"])
    write_model(bad, tmp_path / "m.h5")
    with pytest.warns(UpdynWarning, match="group 'a': stiffness is indefinite"):
        read_model(tmp_path / "m.h5")


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "m.h5"
    write_model(model(), path)
    before = path.read_bytes()
    bad = Model(model().groups, model().dofs, None, "a\0b")
    with pytest.raises(ValueError, match="NUL"):
        write_model(bad, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["m.h5"]


def without_entries(file):
    """Of a matrix that ends with 0 entries nobody but us looks at where its rows start."""
    place = file["groups/0000/mass"]
    starts = place["indptr"][()]
    starts[1:-1], starts[-1] = 2**40, 0
    place["indptr"][...] = starts


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: f.attrs.__setitem__("updyn_kind", "frf"), "read it with updyn.read_frf"),
        (lambda f: f.attrs.__setitem__("updyn_kind", "result"), "read it with updyn.read_result"),
        (lambda f: f.attrs.__setitem__("updyn_kind", "modle"), "did you mean 'modes' or 'model'"),
        (lambda f: f.attrs.__setitem__("updyn_format", 3), "format version 3"),
        (
            lambda f: f.attrs.__delitem__("updyn_kind"),
            "without the attribute 'updyn_kind'.*dofs, geometry, groups",
        ),
        (lambda f: f.__delitem__("dofs"), "no group 'dofs'; found: geometry, groups"),
        (lambda f: f.create_group("grups"), "unknown name 'grups'; did you mean 'groups'"),
        (
            lambda f: f["groups/0000"].create_group("stifness"),
            "unknown name 'stifness'; did you mean 'stiffness'",
        ),
        (
            lambda f: f["groups/0000"].attrs.__setitem__("name", "a_first"),
            "group name 'a_first' occurs twice",
        ),
        (lambda f: f["groups/0000"].attrs.__delitem__("loss_factor"), "no attribute 'loss_factor'"),
        (
            lambda f: f["groups/0000"].attrs.__setitem__("loss_factor", -0.1),
            "group 'shaft': loss factor -0.1",
        ),
        (lambda f: f["dofs/direction"].__setitem__(1, b"RQ"), "direction 2 is 'RQ'"),
        (
            lambda f: f["dofs/node"].__setitem__(2, 1) or f["dofs/direction"].__setitem__(2, b"X"),
            "1:X occurs twice",
        ),
        (
            lambda f: f["groups/0000/stiffness/indices"].__setitem__(0, 9),
            "not a sparse matrix of shape",
        ),
        (
            lambda f: f["groups/0000/stiffness/indices"].__setitem__(slice(0, 2), [1, 1]),
            "an entry occurs twice",
        ),
        (
            lambda f: f["groups/0001/viscous/indices"].__setitem__(0, 0),
            r"entry \(2, 1\) is below the diagonal",
        ),
        (lambda f: f["groups/0000/mass/data"].__setitem__(0, np.nan), "group 'shaft': mass: row 1"),
        (lambda f: f["groups/0000/mass"].__delitem__("indptr"), "no dataset 'indptr'"),
        (without_entries, "/groups/0000/mass: indptr decreases; expected the start of each row"),
    ],
)
def test_a_changed_file_is_refused(tmp_path, change, message):
    path = tmp_path / "m.h5"
    write_model(model(), path)
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(FormatError, match=message) as caught:
        read_model(path)
    assert str(caught.value).startswith(f"{path}: ")


def test_numbers_in_the_other_byte_order(tmp_path):
    path = tmp_path / "model.h5"
    given = model(with_geometry=True)
    write_model(given, path)
    with h5py.File(path, "r+") as file:
        places = []
        file.visititems(lambda name, item: places.append(name) if hasattr(item, "dtype") else None)
        for name in places:
            array = file[name][()]
            if array.dtype.kind in "iuf":
                del file[name]
                file[name] = array.astype(array.dtype.newbyteorder(">"))
    assert_same_model(read_model(path), given)
