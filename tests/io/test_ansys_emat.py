"""Ansys ``.emat`` files: sums of their element matrices against the ``.full`` and the ``.rst`` of the same beam."""

from __future__ import annotations

import contextlib
import functools
import re
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest

import updyn
from updyn.errors import FormatError, JobError, OptionError, UpdynWarning
from updyn.io.ansys.attributes import read_attributes
from updyn.io.ansys.emat import ElementFile

pytest.importorskip("ansys.mapdl.reader", reason="needs updyn[ansys]")
from ansys.mapdl import reader as mapdl
from ansys.mapdl.reader import examples

from ansys_samples import beam_elements, write_emat

pytestmark = pytest.mark.kernels

HALVES = {"root": range(1, 21), "tip": range(21, 41)}


@pytest.fixture(scope="module")
def elements():
    result = mapdl.read_binary(examples.rstfile)
    material = result.materials[1]
    return [
        (number, nodes, {"stiffness": K, "mass": M})
        for number, nodes, K, M in beam_elements(
            result.mesh, material["EX"], material["NUXY"], material["DENS"]
        )
    ]


@pytest.fixture(scope="module")
def folder(elements, tmp_path_factory) -> Path:
    """A job: beam.emat, beam.full, beam.rst."""
    out = tmp_path_factory.mktemp("job")
    write_emat(out / "beam.emat", elements)
    shutil.copy(examples.fullfile, out / "beam.full")
    shutil.copy(examples.rstfile, out / "beam.rst")
    return out


@pytest.fixture(scope="module")
def archive(tmp_path_factory) -> Path:
    """The deck of the same elements, those above 20 of material 2."""
    lines = Path(examples.hexarchivefile).read_text().splitlines()
    for i, line in enumerate(lines):
        fields = line.split()
        if len(fields) == 19 and fields[8] == "20" and fields[0] == "1" and int(fields[10]) > 20:
            lines[i] = f"{2:10d}" + line[10:]
    out = tmp_path_factory.mktemp("deck") / "beam.cdb"
    out.write_text("\n".join(lines))
    return out


def dense(matrix) -> np.ndarray:
    return matrix.toarray()


def test_the_sum_is_the_full_file(folder):
    model = updyn.read_model(folder / "beam.emat", groups=HALVES)
    full = updyn.read_model(folder / "beam.full")
    assert list(model.groups) == ["root", "tip"]
    assert model.dofs == full.dofs
    for own, theirs in ((model.stiffness, full.stiffness), (model.mass, full.mass)):
        assert np.abs(dense(own) - dense(theirs)).max() < 1e-11 * np.abs(dense(theirs)).max()


def test_free_frequencies_are_those_of_the_result_file(folder):
    """Six digits and more against what the program printed for the free beam, after the six rigid body modes."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = updyn.read_model(folder / "beam.emat", groups=HALVES, full=False)
    assert model.n_dofs == 963
    theirs = np.array(mapdl.read_binary(str(folder / "beam.rst")).time_values)
    np.testing.assert_allclose(updyn.modes(model, 12).frequency[6:], theirs, rtol=2e-8)


def test_supports_by_hand_are_those_of_the_full_file(folder):
    by_file = updyn.read_model(folder / "beam.emat", groups=HALVES)
    held = [f"{n}:{d}" for n in range(1, 22) for d in "XYZ"]
    by_hand = updyn.read_model(folder / "beam.emat", groups=HALVES, supports=held)
    assert by_hand.dofs == by_file.dofs
    assert abs(by_hand.stiffness - by_file.stiffness).max() == 0.0


def test_nothing_says_what_is_constrained(folder, tmp_path):
    shutil.copy(folder / "beam.emat", tmp_path / "alone.emat")
    with pytest.warns(UpdynWarning, match="the model is read as free: give full="):
        model = updyn.read_model(tmp_path / "alone.emat", groups=HALVES)
    assert model.n_dofs == 963
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert updyn.read_model(tmp_path / "alone.emat", groups=HALVES, supports=[]).n_dofs == 963


@pytest.mark.parametrize("how", ["rows", "columns", "full"])
def test_every_way_a_matrix_can_be_stored(elements, folder, tmp_path, how):
    write_emat(tmp_path / "other.emat", elements, how=how)
    model = updyn.read_model(tmp_path / "other.emat", groups=HALVES, full=folder / "beam.full")
    first = updyn.read_model(folder / "beam.emat", groups=HALVES)
    for own, theirs in ((model.stiffness, first.stiffness), (model.mass, first.mass)):
        assert abs(own - theirs).max() < 1e-14 * abs(theirs).max()  # rounding of the two triangles


def test_diagonal_masses(tmp_path):
    """A spring between two point masses. The library reads on past the end of a diagonal matrix."""
    k, m = 4.0e4, (2.0, 3.0)
    spring = np.zeros((6, 6))
    spring[np.ix_([0, 3], [0, 3])] = [[k, -k], [-k, k]]
    write_emat(
        tmp_path / "pair.emat",
        [
            (1, [7, 9], {"stiffness": spring, "damping": 1e-3 * spring}),
            (2, [7], {"mass": np.diag([m[0], 0, 0])}),
            (5, [9], {"mass": np.diag([m[1], 0, 0])}),
        ],
        how={"mass": "diagonal", "stiffness": "rows", "damping": "full"},
    )
    with pytest.warns(
        UpdynWarning,
        match="4 degrees of freedom without stiffness, mass and damping are removed; .* 7:Y",
    ):
        model = updyn.read_model(
            tmp_path / "pair.emat", groups={"spring": [1], "masses": [2, 5]}, supports=[]
        )
    assert model.dofs.labels == ["7:X", "9:X"]
    np.testing.assert_array_equal(dense(model.mass), np.diag(m))
    np.testing.assert_allclose(dense(model.group("spring").viscous), [[40, -40], [-40, 40]])
    # omega^2 = k (1/m1 + 1/m2), by hand
    expected = np.sqrt(k * (1 / m[0] + 1 / m[1])) / (2 * np.pi)
    assert updyn.modes(
        updyn.Model(model.groups, model.dofs).scaled({"spring": {"viscous": 0.0}}), 2
    ).frequency[1] == pytest.approx(expected, rel=1e-9)


class TestGroups:
    def test_by_material_from_the_archive(self, folder, archive, tmp_path):
        model = updyn.read_model(
            folder / "beam.emat", attributes=archive, full=folder / "beam.full"
        )
        parts = updyn.read_model(folder / "beam.emat", groups=HALVES)
        assert list(model.groups) == ["material 1", "material 2"]
        for name, half in (("material 1", "root"), ("material 2", "tip")):
            assert abs(model.group(name).stiffness - parts.group(half).stiffness).max() == 0.0
        # Twice the modulus, the same density: what is made of it alone is sqrt(2) up.
        stiff = model.scaled({n: {"stiffness": 2.0} for n in model.groups})
        ratio = updyn.modes(stiff, 1).frequency / updyn.modes(model, 1).frequency
        assert ratio == pytest.approx(np.sqrt(2), rel=1e-9)

    def test_the_files_beside_are_found(self, folder):
        model = updyn.read_model(folder / "beam.emat")
        assert list(model.groups) == ["material 1"]
        assert model.n_dofs == 900
        node = 22
        there = model.geometry.position([node])[0]
        np.testing.assert_allclose(there, [0, 0, 5])
        assert (
            len(model.geometry.lines) == 9 * 10 + 12 * 11
        )  # 2 x 2 x 10 bricks: 9 lines along, 12 edges a layer
        assert len(model.geometry.faces) == 4 * 2 * 10 + 2 * 4

    def test_positions_in_the_unit_that_is_stated(self, folder):
        model = updyn.read_model(folder / "beam.emat", unit="in")
        assert np.ptp(model.geometry.xyz, axis=0) == pytest.approx([0.0254, 0.0254, 0.127])

    @pytest.mark.parametrize(
        ("by", "name"), [("type", "type 1"), ("real", "real 1"), ("section", "section 1")]
    )
    def test_by_number(self, folder, by, name):
        assert list(updyn.read_model(folder / "beam.emat", by=by).groups) == [name]

    def test_by_component(self, folder, archive, tmp_path):
        text = archive.read_text()
        one = tmp_path / "one.cdb"
        block = re.search(r"CMBLOCK,ECOMP2 .*?\n(?=CMBLOCK)", text, re.DOTALL)
        one.write_text(text.replace(block[0], ""))
        model = updyn.read_model(folder / "beam.emat", by="component", attributes=one)
        assert list(model.groups) == ["ECOMP1", "remaining"]
        numbers = [17, 18, *range(21, 41)]
        same = updyn.read_model(folder / "beam.emat", groups={"ECOMP1": numbers})
        assert abs(model.group("ECOMP1").mass - same.group("ECOMP1").mass).max() == 0.0

    def test_groups_are_merged_by_element_numbers_names_and_components(self, folder, archive):
        numbers = {"root": range(1, 17), "end": [17, 18], "rest": [19, 20], "tip": range(21, 41)}
        patterns = {"beam": ["root", "tip"]}
        read = functools.partial(updyn.read_model, folder / "beam.emat", attributes=archive)
        model = read(groups=numbers | patterns)
        assert sorted(model.groups) == ["beam", "end", "rest"]
        assert list(model.group("beam").origin.members) == ["root", "tip"]
        by_component = read(groups=numbers | {"a": "component ECOMP1"})
        assert sorted(by_component.groups) == ["a", "rest", "root"]
        with pytest.raises(FormatError, match="'component ECOMP1' contains only a part of group"):
            read(groups={"a": "component ECOMP1"})

    def test_an_element_in_two_components(self, folder, archive):
        with pytest.raises(FormatError, match=r"element 17 \(4 such\) is in 'ECOMP1' and 'ECOMP2'"):
            updyn.read_model(folder / "beam.emat", by="component", attributes=archive)

    def test_springs_are_grouped_by_real_constants(self, folder, archive, tmp_path):
        """A spring has no material, whatever material number it is given."""
        text = archive.read_text().replace("ET,        1,186", "ET,        1,186\nET,        2,14")
        text = text.replace("SOLID,        40,        40", "SOLID,        41,        41")
        row = [1, 2, 4, 1, 0, 0, 0, 0, 2, 0, 41, 1, 22]
        text = text.replace(
            "\n        -1\nCMBLOCK,ECOMP1",
            "\n" + "".join(f"{v:10d}" for v in row) + "\n        -1\nCMBLOCK,ECOMP1",
        )
        (tmp_path / "spring.cdb").write_text(text)
        result = mapdl.read_binary(examples.rstfile)
        spring = np.zeros((6, 6))
        spring[np.ix_([2, 5], [2, 5])] = 1e3 * np.array([[1, -1], [-1, 1]])
        bricks = [
            (number, nodes, {"stiffness": K, "mass": M})
            for number, nodes, K, M in beam_elements(result.mesh, 16.9e6, 0.31, 4.1408e-4)
        ]
        write_emat(tmp_path / "spring.emat", [*bricks, (41, [1, 22], {"stiffness": spring})])
        model = updyn.read_model(tmp_path / "spring.emat", supports=[])
        assert list(model.groups) == ["material 1", "material 2", "real 4"]
        at = model.dofs.match(["22:Z"]).index[0]
        assert model.group("real 4").stiffness[at, at] == 1e3

    def test_no_attributes(self, folder, tmp_path):
        shutil.copy(folder / "beam.emat", tmp_path / "alone.emat")
        with pytest.raises(
            FormatError, match="does not contain the material of its elements: give attributes="
        ):
            updyn.read_model(tmp_path / "alone.emat", supports=[])

    def test_elements_that_the_archive_lacks(self, folder, archive, tmp_path):
        """Mechanical writes a block a body, and the library reads the first one."""
        lines = archive.read_text().splitlines()
        at = next(
            i
            for i, line in enumerate(lines)
            if line.split()[:1] == ["-1"] and lines[i + 1].startswith("CMBLOCK")
        )
        del lines[at - 4 : at]
        (tmp_path / "part.cdb").write_text(
            "\n".join(lines).replace("SOLID,        40,        40", "SOLID,        38,        38")
        )
        with pytest.raises(
            FormatError, match=r"element 39 \(2 such\) is not in part.cdb, which has 38 elements"
        ):
            updyn.read_model(folder / "beam.emat", attributes=tmp_path / "part.cdb")

    @pytest.mark.parametrize(
        ("options", "error", "said"),
        [
            ({"by": "materials"}, OptionError, "by='materials': did you mean 'material'"),
            ({"groups": {"a": [1, 99]}}, OptionError, r"'a' contains element 99 \(1 such\)"),
            ({"groups": {"a": []}}, OptionError, "'a' is empty"),
            ({"groups": {}}, OptionError, "groups: none contains"),
            ({"groups": {"a": [1], "b": [1, 2]}}, FormatError, "element 1 .* is in 'a' and 'b'"),
            ({"attributes": "absent.cdb"}, FormatError, "attributes: no such file"),
            ({"full": "absent.full"}, FormatError, "full: no such file"),
            ({"full": True}, OptionError, "full=True"),
            ({"full": "beam.full", "supports": []}, OptionError, "both define the supports"),
            ({"supports": ["999:X"]}, FormatError, "supports: DOF 999:X is not among"),
            ({"stress_stiffness": True}, FormatError, "no element has any"),
            ({"group": {}}, OptionError, "has no option 'group'; did you mean 'groups'"),
        ],
    )
    def test_bad_options(self, folder, options, error, said):
        with pytest.raises(error, match=said):
            updyn.read_model(folder / "beam.emat", **options)


class TestChecks:
    def test_groups_that_do_not_add_up(self, elements, folder, tmp_path):
        """One element of 40 is 1 ppm off."""
        number, nodes, parts = elements[25]
        off = [
            *elements[:25],
            (number, nodes, {**parts, "stiffness": parts["stiffness"] * (1 + 1e-6)}),
            *elements[26:],
        ]
        write_emat(tmp_path / "off.emat", off)
        with pytest.raises(
            FormatError,
            match=r"do not add up to the \.full file: stiffness at \d+:[XYZ], \d+:[XYZ] differs",
        ):
            updyn.read_model(tmp_path / "off.emat", groups=HALVES, full=folder / "beam.full")

    def test_an_element_is_missing(self, elements, folder, tmp_path):
        write_emat(tmp_path / "off.emat", elements[:-1])
        with pytest.raises(FormatError, match=r"do not add up|on which no element acts"):
            updyn.read_model(
                tmp_path / "off.emat",
                groups={"all": [e[0] for e in elements[:-1]]},
                full=folder / "beam.full",
            )

    def test_attributes_of_another_model(self, elements, folder, tmp_path):
        swapped = [
            (elements[1][0], *elements[0][1:]),
            (elements[0][0], *elements[1][1:]),
            *elements[2:],
        ]
        write_emat(tmp_path / "swapped.emat", swapped)
        with pytest.raises(
            FormatError, match=r"element \d+ acts on node \d+, which it does not have in beam.rst"
        ):
            updyn.read_model(tmp_path / "swapped.emat", attributes=folder / "beam.rst", supports=[])

    def test_stress_stiffness_has_to_be_said(self, elements, tmp_path):
        number, nodes, parts = elements[0]
        write_emat(
            tmp_path / "s.emat",
            [(number, nodes, {**parts, "stress stiffness": 0.01 * parts["stiffness"]})],
        )
        groups = {"bar": [number]}
        with pytest.raises(OptionError, match="stress_stiffness=True"):
            updyn.read_model(tmp_path / "s.emat", groups=groups, supports=[])
        without = updyn.read_model(
            tmp_path / "s.emat", groups=groups, supports=[], stress_stiffness=False
        )
        with_it = updyn.read_model(
            tmp_path / "s.emat", groups=groups, supports=[], stress_stiffness=True
        )
        assert list(with_it.groups) == ["bar", "stress stiffness"]
        np.testing.assert_allclose(
            dense(with_it.stiffness), 1.01 * dense(without.stiffness), rtol=1e-12
        )

    def test_internal_constraints(self, elements, tmp_path):
        write_emat(tmp_path / "joint.emat", elements, internal_equations=2)
        with pytest.raises(FormatError, match="2 internal constraint equations"):
            updyn.read_model(tmp_path / "joint.emat", groups=HALVES)

    def test_unsymmetric_elements(self, elements, tmp_path):
        number, nodes, parts = elements[0]
        K = parts["stiffness"].copy()
        K[0, 1] += K[0, 0]
        write_emat(tmp_path / "u.emat", [(number, nodes, {"stiffness": K})], how="full")
        with pytest.raises(FormatError, match=r"element 1: stiffness is unsymmetric"):
            updyn.read_model(tmp_path / "u.emat", groups={"a": [1]}, supports=[])

    def test_a_thermal_model(self, tmp_path):
        write_emat(
            tmp_path / "hot.emat",
            [(1, [1, 2], {"stiffness": np.array([[1.0, -1], [-1, 1]])})],
            dofs=(20,),
        )
        with pytest.raises(FormatError, match=r"node 1 has the degree of freedom TEMP \(2 such\)"):
            updyn.read_model(tmp_path / "hot.emat", groups={"a": [1]}, supports=[])

    def test_rotations_by_name(self, tmp_path):
        """A plane beam has UX, UY and ROTZ: three DOFs a node, of which the third is the sixth."""
        write_emat(
            tmp_path / "plane.emat", [(1, [3, 4], {"stiffness": np.eye(6) * 5})], dofs=(1, 2, 6)
        )
        model = updyn.read_model(tmp_path / "plane.emat", groups={"a": [1]}, supports=[])
        assert model.dofs.labels == ["3:X", "3:Y", "3:RZ", "4:X", "4:Y", "4:RZ"]

    def test_rotations_in_the_unit_that_is_stated(self, tmp_path):
        """N/mm are 1000 N/m, N stays N, N mm is a thousandth of N m."""
        K = np.array([[2.0, 3.0], [3.0, 9.0]])
        write_emat(tmp_path / "mm.emat", [(1, [3], {"stiffness": K})], dofs=(2, 6))
        model = updyn.read_model(tmp_path / "mm.emat", groups={"a": [1]}, supports=[], unit="mm")
        np.testing.assert_allclose(dense(model.stiffness), [[2000.0, 3.0], [3.0, 9e-3]], rtol=1e-14)

    @pytest.mark.parametrize("share", [0.001, 0.003, 0.05, 0.5, 0.999])
    def test_cut_short(self, folder, tmp_path, share):
        whole = (folder / "beam.emat").read_bytes()
        (tmp_path / "cut.emat").write_bytes(whole[: int(len(whole) * share)])
        with pytest.raises(FormatError):
            updyn.read_model(tmp_path / "cut.emat", groups=HALVES, format="ansys_emat")

    def test_bytes_turned_over(self, elements, tmp_path):
        """Whatever a damaged file says, it is an error of ours or a model, never a crash."""
        write_emat(tmp_path / "good.emat", elements[:2])
        whole = bytearray((tmp_path / "good.emat").read_bytes())
        rng = np.random.default_rng(5)
        groups = {"a": [elements[0][0], elements[1][0]]}
        for at in rng.integers(412, min(len(whole), 6000), 60):
            broken = bytearray(whole)
            broken[at] ^= 1 << int(rng.integers(8))
            (tmp_path / "bad.emat").write_bytes(bytes(broken))
            with warnings.catch_warnings(), contextlib.suppress(updyn.UpdynError):
                warnings.simplefilter("ignore", UpdynWarning)
                updyn.read_model(tmp_path / "bad.emat", groups=groups, supports=[])


def test_storage_order_of_nodes_is_not_that_of_numbers(folder):
    file = ElementFile(folder / "beam.emat")
    assert not np.all(np.diff(file._nodes) > 0)


def test_nodal_systems(folder, archive, tmp_path):
    """A node turned by 30 degrees about Z: its X points to (cos 30, sin 30, 0)."""
    lines = archive.read_text().splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("       22        0        0"))
    assert len(lines[at]) == 27 + 3 * 21
    lines[at] += " 3.0000000000000E+001"
    (tmp_path / "turned.cdb").write_text("\n".join(lines))
    geometry = read_attributes(tmp_path / "turned.cdb").geometry(1.0)
    turned = geometry.axes[geometry.nodes.tolist().index(22)]
    np.testing.assert_allclose(turned[0], [np.cos(np.pi / 6), np.sin(np.pi / 6), 0], atol=1e-12)
    np.testing.assert_allclose(turned[1], [-np.sin(np.pi / 6), np.cos(np.pi / 6), 0], atol=1e-12)
    np.testing.assert_array_equal(geometry.axes[geometry.nodes.tolist().index(23)], np.eye(3))


@pytest.mark.parametrize("angles", [(0, 25, 0), (0, 0, -40), (30, 25, -40)])
def test_nodal_angles_turn_about_z_then_x_then_y(angles):
    """Against rotation by one matrix after another, about axes that turn along."""
    from scipy.spatial.transform import Rotation

    from updyn.io.ansys.attributes import _axes

    z, x, y = angles
    expected = Rotation.from_euler("ZXY", [z, x, y], degrees=True).as_matrix().T
    np.testing.assert_allclose(_axes(np.array([[z, x, y]], dtype=float))[0], expected, atol=1e-14)


def test_recovery(folder):
    """Stiffness and mass of the halves, changed and found again from noise-free FRFs at four points."""
    start = updyn.read_model(folder / "beam.emat", groups=HALVES, unit="in", loss_factor=0.01)
    truth = {"root": {"stiffness": 0.86, "mass": 1.05}, "tip": {"stiffness": 1.12, "mass": 0.93}}
    freq = np.linspace(900.0, 7200.0, 22)
    frf = updyn.response(
        start.scaled(truth), freq, ["22:X", "22:Z", "290:X", "298:X"], ["22:X", "22:Z"]
    )
    result = updyn.update(
        start, frf, updyn.parameters(start, stiffness="all", mass="all"), noise={"relative": 1e-6}
    )
    assert result.status == "converged"
    for group, change in truth.items():
        for quantity, value in change.items():
            assert result.values[f"{group}.{quantity}"] == pytest.approx(value, rel=1e-6)


def test_a_job(folder, archive, tmp_path):
    """A job names the .emat and its options; the files beside it are found."""
    from updyn.job import load_job, prepare

    for name in ("beam.emat", "beam.full"):
        shutil.copy(folder / name, tmp_path / name)
    shutil.copy(archive, tmp_path / "beam.cdb")
    model = updyn.read_model(tmp_path / "beam.emat", unit="in", loss_factor=0.01)
    updyn.write_frf(
        updyn.response(model, [900.0, 1200.0, 1500.0], ["22:X"], ["22:X"]), tmp_path / "test.npz"
    )
    (tmp_path / "job.toml").write_text(
        '[model]\nfile = "beam.emat"\nunit = "in"\nloss_factor = 0.01\n[test]\nfile = "test.npz"\n'
        '[[parameter]]\ngroups = ["material *"]\nquantity = "stiffness"\n'
    )
    prepared = prepare(load_job(tmp_path / "job.toml"))
    assert prepared.parameters.names == ["material 1.stiffness", "material 2.stiffness"]
    assert abs(prepared.model.stiffness - model.stiffness).max() == 0.0


def test_a_job_says_before_the_fit_what_its_deck_has_no_properties_of(folder, archive, tmp_path):
    """Its elements name material 2; no MP or MPDATA says what that is."""
    from updyn.job import load_job, prepare

    for name in ("beam.emat", "beam.full"):
        shutil.copy(folder / name, tmp_path / name)
    shutil.copy(archive, tmp_path / "beam.cdb")
    model = updyn.read_model(tmp_path / "beam.emat", unit="in")
    updyn.write_frf(updyn.response(model, [900.0], ["22:X"], ["22:X"]), tmp_path / "test.npz")
    job = (
        '[model]\nfile = "beam.emat"\nunit = "in"\n[test]\nfile = "test.npz"\n'
        '[[parameter]]\ngroups = ["material *"]\nquantity = "stiffness"\n'
        '[output]\nproperties = "new.inp"\n'
    )
    (tmp_path / "job.toml").write_text(job)
    with pytest.raises(JobError, match=r"has no properties of 'material 2'.*MP") as caught:
        prepare(load_job(tmp_path / "job.toml"))
    assert caught.value.line == 10
    (tmp_path / "job.toml").write_text(job.replace("material *", "material 1"))
    prepare(load_job(tmp_path / "job.toml"))
    assert not (tmp_path / "new.inp").exists()
