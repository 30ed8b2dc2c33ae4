"""Ansys ``.full`` files, held to the textbook's brick and to the file's own numbers."""

from __future__ import annotations

import contextlib
import struct
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp

import updyn
from updyn.errors import FormatError, OptionError, UpdynError
from updyn.io.ansys import full as ansys_full
from updyn.io.ansys.attributes import read_attributes

pytest.importorskip("ansys.mapdl.reader", reason="needs updyn[ansys]")
from ansys.mapdl import reader as mapdl
from ansys.mapdl.reader import examples

from ansys_samples import beam_elements

FULL, RST = Path(examples.fullfile), Path(examples.rstfile)
WORD = 4
# Items of the header of the file, counted from 0, and where its words stand.
HEADER = 105
ITEM = {
    "lumpm": 10,
    "keyuns": 13,
    "ncefull": 20,
    "ntermMl": 33,
    "ntermDl": 34,
    "ptrDMPl": 28,
    "ptrMASl": 26,
}
ITEM |= {"distKey": 62, "nVirtBCs": 79, "fun04": 0, "ntermMh": 21}


def words(path: Path = FULL) -> np.ndarray:
    return np.frombuffer(path.read_bytes(), dtype="<i4").copy()


def changed(tmp_path: Path, **items: int) -> Path:
    """Write the file with items of its header changed."""
    w = words()
    for name, value in items.items():
        w[HEADER + ITEM[name]] = value
    out = tmp_path / "changed.full"
    out.write_bytes(w.tobytes())
    return out


@pytest.fixture(scope="module")
def model() -> updyn.Model:
    return updyn.read_model(FULL)


@pytest.fixture(scope="module")
def textbook() -> tuple[dict[tuple[int, int], int], np.ndarray, np.ndarray]:
    """K and M of the beam from its nodes, elements and material, by node and direction."""
    result = mapdl.read_binary(str(RST))
    material = result.materials[1]
    at = {(int(n), a): 3 * i + a for i, n in enumerate(result.mesh.nnum) for a in range(3)}
    K, M = np.zeros((len(at), len(at))), np.zeros((len(at), len(at)))
    for _, nodes, k, m in beam_elements(
        result.mesh, material["EX"], material["NUXY"], material["DENS"]
    ):
        rows = np.ix_(*[[at[n, a] for n in nodes for a in range(3)]] * 2)
        K[rows] += k
        M[rows] += m
    return at, K, M


def test_matrices_are_those_of_textbook_bricks(model, textbook):
    at, K, M = textbook
    rows = [at[d.node, "XYZ".index(d.direction)] for d in model.dofs]
    for read, own in ((model.stiffness, K), (model.mass, M)):
        expected = own[np.ix_(rows, rows)]
        assert np.abs(read.toarray() - expected).max() < 1e-11 * np.abs(expected).max()


def test_frequencies(model):
    # A cantilever of side 1 and length 5 with c = sqrt(E/rho): Euler-Bernoulli puts its first pair
    # at 1.8751^2/(2 pi) c sqrt(1/12)/25 = 1305.3 Hz (Blevins 1979, table 8-1); shear and inertia
    # take 2 % off.
    c = np.sqrt(16.9e6 / 4.1408e-4)
    euler = 1.87510407**2 / (2 * np.pi) * c * np.sqrt(1 / 12) / 25
    first = updyn.modes(model, 6).frequency
    assert first[0] == pytest.approx(first[1], rel=1e-9)
    assert 0.97 < first[0] / euler < 1.0
    np.testing.assert_allclose(
        first,
        [1283.2003692, 1283.2003692, 5781.9748617, 6919.3988771, 6919.3988771, 10172.614977],
        rtol=1e-8,
    )


def test_both_triangles_are_there_and_the_library_alone_gives_one(model):
    """ansys-mapdl-reader returns upper triangles, with the supports as empty rows; the entries are ours."""
    from ansys.mapdl.reader.full import FullFile

    dof_ref, *triangles = FullFile(str(FULL)).load_km(sort=True)
    at = {(int(n), int(a)): i for i, (n, a) in enumerate(dof_ref)}
    rows = [at[d.node, "XYZ".index(d.direction)] for d in model.dofs]
    for whole, upper in zip((model.stiffness, model.mass), triangles, strict=True):
        assert sp.tril(upper, -1).nnz == 0
        assert abs(whole - whole.T).max() == 0.0
        np.testing.assert_array_equal(sp.triu(whole).toarray(), upper.toarray()[np.ix_(rows, rows)])


def test_supports_are_left_out_and_named():
    """There are 21 nodes at the held end, z = 0."""
    system = ansys_full.read_system(FULL)
    mesh = mapdl.read_binary(str(RST)).mesh
    held = sorted(int(n) for n, z in zip(mesh.nnum, mesh.nodes[:, 2], strict=True) if abs(z) < 1e-9)
    assert len(held) == 21
    assert system.supports == updyn.DofSet([d for d in system.supports])  # noqa: C416
    assert sorted(set(system.supports.nodes.tolist())) == held
    assert len(system.supports) == 63
    assert len(system.dofs) == 3 * 321 - 63
    assert not any(d in system.dofs for d in system.supports)


def test_labels_are_sorted_and_go_with_their_rows(model, textbook):
    assert model.dofs.labels[:4] == ["22:X", "22:Y", "22:Z", "23:X"]
    at, _, M = textbook
    row = model.dofs.match(["290:Y"]).index[0]
    assert model.mass.toarray()[row, row] == pytest.approx(M[at[290, 1], at[290, 1]], rel=1e-11)


def test_damping_of_the_file_is_read(tmp_path):
    """The file of the package has no C. Here it is told that its mass matrix is its damping matrix too."""
    w = words()
    file = changed(
        tmp_path, ptrDMPl=w[HEADER + ITEM["ptrMASl"]], ntermDl=w[HEADER + ITEM["ntermMl"]]
    )
    model = updyn.read_model(file)
    assert abs(model.viscous - model.mass).max() == 0.0


def test_without_mass(tmp_path):
    model = updyn.read_model(changed(tmp_path, ntermMl=0, ntermMh=0))
    assert model.group("model").mass is None
    assert model.stiffness.nnz


@pytest.mark.parametrize(
    ("items", "said"),
    [
        ({"lumpm": 1}, "lumped mass matrix; solve with LUMPM,OFF"),
        ({"keyuns": 1}, "unsymmetric"),
        ({"ncefull": 3}, "3 constraint equations"),
        ({"distKey": 1}, "one part of a distributed solution"),
        ({"nVirtBCs": 2}, "virtual constraints"),
        ({"fun04": 4}, "frontal solver"),
        ({"ntermMl": 17_000}, "mass: 17793 entries, expected 17000 by the header"),
        ({"ptrDMPl": 10**8, "ntermDl": 5}, "damping: extends to word 100000000 of 212992"),
    ],
)
def test_what_the_matrices_do_not_show_is_refused(tmp_path, items, said):
    with pytest.raises(FormatError, match=said):
        updyn.read_model(changed(tmp_path, **items))


@pytest.mark.parametrize("size", [2, 300, 416, 3000, 500_000, 780_000])
def test_cut_short(tmp_path, size):
    file = tmp_path / "short.full"
    file.write_bytes(FULL.read_bytes()[:size])
    with pytest.raises(FormatError):
        updyn.read_model(file, format="ansys_full")


def test_other_degrees_of_freedom_are_refused_by_name(tmp_path):
    w = words()
    vector = int(w[HEADER + 35]) + 324 + 2  # the DOF vector follows the extent vector of 321 nodes
    assert w[vector] == -1
    assert w[vector + 900] == 1
    w[vector + 902] = 20
    (tmp_path / "hot.full").write_bytes(w.tobytes())
    with pytest.raises(
        FormatError, match=r"node \d+ has the degree of freedom TEMP; expected only displacements"
    ):
        updyn.read_model(tmp_path / "hot.full")


def test_another_file_of_ansys_is_named():
    with pytest.raises(
        FormatError, match=r"is a \.rst file of Ansys by its header, expected \.full"
    ):
        updyn.read_model(RST, format="ansys_full")


def test_the_other_byte_order_is_refused(tmp_path):
    (tmp_path / "big.full").write_bytes(struct.pack(">i", 100) + bytes(1000))
    with pytest.raises(FormatError, match="little-endian"):
        updyn.read_model(tmp_path / "big.full", format="ansys_full")


class TestUnits:
    def test_inches_and_pounds(self, model):
        si = updyn.read_model(FULL, unit="in")
        pound, inch = 4.4482216152605, 0.0254
        ratio = si.stiffness.toarray()[0, 0] / model.stiffness.toarray()[0, 0]
        assert ratio == pytest.approx(pound / inch, rel=1e-12)
        np.testing.assert_allclose(
            updyn.modes(si, 3).frequency, updyn.modes(model, 3).frequency, rtol=1e-9
        )
        # A titanium bar of 1 x 1 x 5 in: 4.1408e-4 lbf s2/in4 is 4425 kg/m3.
        volume = 5 * inch**3
        K = 4.1408e-4 * pound / inch**4 * volume
        free_mass = float(si.mass.sum()) / 3
        assert 0.97 * K < free_mass < K  # a little of it stands on the supports

    def test_a_unit_that_contradicts_the_header(self, tmp_path):
        w = words()
        w[6] = 6
        (tmp_path / "mpa.full").write_bytes(w.tobytes())
        with pytest.raises(
            FormatError, match=r"unit 'in' contradicts the header, which states MPA \(mm, N, t\)"
        ):
            updyn.read_model(tmp_path / "mpa.full", unit="in")
        said = updyn.read_model(tmp_path / "mpa.full")
        stated = updyn.read_model(FULL, unit="mm")
        assert abs(said.stiffness - stated.stiffness).max() == 0.0

    def test_a_header_in_centimetres(self, tmp_path):
        w = words()
        w[6] = 2
        (tmp_path / "cgs.full").write_bytes(w.tobytes())
        with pytest.raises(FormatError, match="units CGS, which are not converted"):
            updyn.read_model(tmp_path / "cgs.full")

    def test_unknown(self):
        with pytest.raises(OptionError, match="unit 'inch'"):
            updyn.read_model(FULL, unit="inch")


def scaled_file(tmp_path: Path, name: str, factor_k: float, factor_m: float) -> Path:
    """Write the file with all of its K and M multiplied."""
    w = words()
    for pointer, factor in (
        (int(w[HEADER + 18]), factor_k),
        (int(w[HEADER + ITEM["ptrMASl"]]), factor_m),
    ):
        at = pointer
        for row in range(2 * 963):
            n = int(w[at])
            if row % 2:
                values = w[at + 2 : at + 2 + n].view("<f8")
                values *= factor
            at += n + 3
    (tmp_path / name).write_bytes(w.tobytes())
    return tmp_path / name


class TestGroupsByDifference:
    def test_one_group_is_the_whole(self, tmp_path, model):
        file = scaled_file(tmp_path, "bar.full", 2.0, 2.0)
        two = updyn.read_model(FULL, doubled={"bar": file}, loss_factor=0.01)
        assert list(two.groups) == ["bar"]
        assert abs(two.stiffness - model.stiffness).max() == 0.0
        assert two.group("bar").loss_factor == 0.01

    def test_groups_that_do_not_add_up(self, tmp_path):
        file = scaled_file(tmp_path, "bar.full", 1.5, 2.0)
        with pytest.raises(FormatError, match="the groups do not add up to K"):
            updyn.read_model(FULL, doubled={"bar": file})

    def test_nothing_doubled(self):
        with pytest.raises(FormatError, match=r"group 'bar': .* the same matrices|do not add up"):
            updyn.read_model(FULL, doubled={"bar": FULL})

    def test_no_such_file(self, tmp_path):
        with pytest.raises(FormatError, match="no such file for group 'bar'"):
            updyn.read_model(FULL, doubled={"bar": tmp_path / "absent.full"})

    def test_empty(self):
        with pytest.raises(OptionError, match="doubled: expected a mapping"):
            updyn.read_model(FULL, doubled={})


def test_without_the_package(monkeypatch, tmp_path):
    """A .full file needs nothing; which element is of which material, the package reads."""
    monkeypatch.setitem(sys.modules, "ansys.mapdl", None)
    monkeypatch.delitem(sys.modules, "updyn.foreign.ansys", raising=False)
    assert updyn.read_model(FULL).n_dofs == 900
    with pytest.raises(UpdynError, match=r"pip install 'updyn\[ansys\]'"):
        read_attributes(examples.hexarchivefile)


def test_damaged_bytes(tmp_path):
    """Whatever a damaged file says, it is an error of ours or a model. In the package it ends the process."""
    whole = FULL.read_bytes()
    rng = np.random.default_rng(3)
    for low, high in ((412, 1100), (2144, 60_000), (520_000, 700_000), (520_544, 529_544)):
        for at in rng.integers(low, high, 12):
            broken = bytearray(whole)
            broken[at] ^= 1 << int(rng.integers(8))
            (tmp_path / "bad.full").write_bytes(bytes(broken))
            with warnings.catch_warnings(), contextlib.suppress(UpdynError):
                warnings.simplefilter("ignore")
                updyn.read_model(tmp_path / "bad.full", format="ansys_full")


def test_told_by_content(tmp_path):
    """A file of any name, and options checked by name."""
    (tmp_path / "job.bin").write_bytes(FULL.read_bytes())
    assert updyn.read_model(tmp_path / "job.bin").n_dofs == 900
    with pytest.raises(OptionError, match="has no option 'units'; did you mean 'unit'"):
        updyn.read_model(FULL, units="in")
