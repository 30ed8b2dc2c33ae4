"""Modes in universal files: dataset 55 field by field, units, round trips, pyuff as a second opinion, bad files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyuff

import uff_samples as uff
import updyn
from updyn.errors import FormatError, UpdynWarning
from updyn.modal import ModeSet


def dataset(
    *,
    analysis: int = 2,
    characteristic: int = 2,
    specific: int = 8,
    kind: int = 2,
    width: int = 3,
    head: Sequence[float] = (10.0, 0.0, 0.0, 0.0),
    nodes: dict[int, Sequence[float]] | None = None,
) -> bytes:
    """A dataset 55 by the columns of the format."""
    values = {1: [1.0, 0.0, -2.0], 2: [0.5, 0.0, 1.0]} if nodes is None else nodes
    lines = ["Mode", "NONE", "NONE", "NONE", "NONE"]
    lines.append("".join(f"{v:10d}" for v in (1, analysis, characteristic, specific, kind, width)))
    lines.append("".join(f"{v:10d}" for v in (2, len(head), 1, 1)))
    lines.append("".join(f"{v:13.5E}" for v in head))
    for node, row in values.items():
        lines.append(f"{node:10d}")
        lines += ["".join(f"{v:13.5E}" for v in row[i : i + 6]) for i in range(0, len(row), 6)]
    return uff.text(55, *lines)


def put(tmp_path: Path, *parts: bytes) -> Path:
    path = tmp_path / "modes.unv"
    path.write_bytes(b"".join(parts))
    return path


def test_normal_modes(tmp_path: Path) -> None:
    """Unused values are 0, and no DOFs: Y moves in no mode."""
    second = dataset(head=(20.0, 4.0, 0.01, 0.003), nodes={1: [0.0, 0.0, 3.0], 2: [2.0, 0.0, 0.0]})
    modes = updyn.read_modes(put(tmp_path, dataset(), second))
    assert modes.dofs.labels == ["1:X", "1:Z", "2:X", "2:Z"]
    assert modes.frequency.tolist() == [10.0, 20.0]
    assert np.isnan(modes.loss_factor[0])  # 0 in both fields says nothing
    assert modes.loss_factor[1] == pytest.approx(2 * 0.01 + 0.003)
    assert modes.scaled.tolist() == [False, True]
    assert modes.shapes[:, 0].tolist() == [1.0, -2.0, 0.5, 1.0]
    assert modes.shapes[:, 1].tolist() == [0.0, 1.5, 1.0, 0.0]  # over the root of the modal mass
    assert np.isnan(modes.quality).all()
    assert modes.source == "modes.unv"


def test_nodes_left_out_of_a_mode_are_zero_there(tmp_path: Path) -> None:
    """Note 9 of the format: a record of zeros need not appear."""
    modes = updyn.read_modes(
        put(tmp_path, dataset(), dataset(head=(20.0, 0, 0, 0), nodes={2: [0.0, 1.0, 0.0]}))
    )
    assert modes.dofs.labels == ["1:X", "1:Z", "2:X", "2:Y", "2:Z"]
    assert modes.shapes[:, 1].tolist() == [0.0, 0.0, 0.0, 1.0, 0.0]


@pytest.mark.parametrize("analysis", [3, 7])
def test_complex_modes(tmp_path: Path, analysis: int) -> None:
    s, a = complex(-0.3, 62.8), complex(0.1, 2.0)
    head = (s.real, s.imag, a.real, a.imag, 0.0, 0.0)
    rows = {5: [1.0, 0.1, 0.0, 0.0, -2.0, 0.3]}
    modes = updyn.read_modes(
        put(tmp_path, dataset(analysis=analysis, kind=5, head=head, nodes=rows))
    )
    assert modes.frequency == pytest.approx([abs(s) / (2 * np.pi)], rel=1e-5)
    assert modes.loss_factor == pytest.approx([0.6 / abs(s)], rel=1e-5)
    # phi^T (2 s M + C) phi = a: with a = 2 i omega_d the shape has unit modal mass.
    expected = np.array([1.0 + 0.1j, -2.0 + 0.3j]) * np.sqrt(2j * s.imag / a)
    assert modes.shapes[:, 0] == pytest.approx(expected, rel=1e-5)
    assert modes.scaled.all()


def test_of_conjugate_modes_the_upper_one_is_taken(tmp_path: Path) -> None:
    pair = [
        dataset(
            analysis=3,
            kind=5,
            head=(-0.3, sign * 62.8, 0, 0, 0, 0),
            nodes={5: [1, sign * 0.1, 0, 0, 0, 0]},
        )
        for sign in (1, -1)
    ]
    both = updyn.read_modes(put(tmp_path, *pair))
    assert len(both) == 1
    assert both.shapes[0, 0] == pytest.approx(1.0 + 0.1j)
    lower = updyn.read_modes(put(tmp_path, pair[1]))  # alone it says the same
    assert lower.shapes[0, 0] == pytest.approx(1.0 + 0.1j)
    assert not lower.scaled.any()


def test_units(tmp_path: Path) -> None:
    """In millimetres: the same mode as in metres, rotations as they are."""
    millimetres = uff.text(
        164,
        f"{5:10d}{'mm':<20}{2:10d}",
        "".join(f"{v:25.17E}" for v in (1e3, 1e3, 1.0)),
        f"{0.0:25.17E}",
    )
    # 2 kg m2 is 2e6 in N mm s2, as millinewton times millimetre is 1e-6 N m and the factor of force
    # is 1000.
    rows = {1: [1000.0, 0, 0, 0, 0, 0.25]}
    head = (10.0, 2e6, 0.0, 0.0)
    got = updyn.read_modes(
        put(tmp_path, millimetres, dataset(characteristic=3, width=6, head=head, nodes=rows))
    )
    rows, head = {1: [1.0, 0, 0, 0, 0, 0.25]}, (10.0, 2.0, 0.0, 0.0)
    same = updyn.read_modes(
        put(tmp_path, dataset(characteristic=3, width=6, head=head, nodes=rows))
    )
    assert got.dofs.labels == same.dofs.labels == ["1:X", "1:RZ"]
    assert got.shapes == pytest.approx(same.shapes, rel=1e-6)


@pytest.mark.parametrize("specific", [11, 12])
def test_shapes_of_velocities_and_accelerations_are_unscaled(tmp_path: Path, specific: int) -> None:
    """They are those of displacements times s or s squared: the same up to a factor."""
    plain = updyn.read_modes(put(tmp_path, dataset(specific=specific)))
    assert not plain.scaled.any()
    with pytest.warns(UpdynWarning, match=r"modal mass or modal A of 1 mode .* not used.*line 2"):
        found = updyn.read_modes(put(tmp_path, dataset(specific=specific, head=(10.0, 4.0, 0, 0))))
    assert not found.scaled.any()
    assert found.shapes[:, 0].tolist() == [1.0, -2.0, 0.5, 1.0]


@pytest.mark.parametrize("specific", [3, 13])
def test_vectors_that_are_no_motions_are_left_out(tmp_path: Path, specific: int) -> None:
    data = dataset() + dataset(specific=specific)
    with pytest.warns(UpdynWarning, match=f"ignored: 1 data type {specific} of modes"):
        assert len(updyn.read_modes(put(tmp_path, data))) == 1


# -- eigenvalue, modal A and B, damping ------------------------------------------------------------------
RATIO = 0.01  # of critical damping
OMEGA = 2 * np.pi * 19.62
S = complex(-RATIO * OMEGA, OMEGA * np.sqrt(1 - RATIO**2))  # in rad/s
A = 2j * S.imag  # of unit modal mass


def complex_mode(s: complex, a: complex = 0j, b: complex = 0j, note: str = "NONE") -> bytes:
    head = (s.real, s.imag, a.real, a.imag, b.real, b.imag)
    data = dataset(analysis=3, kind=5, head=head, nodes={5: [1.0, 0, 0, 0, 0, 0]})
    return data.replace(b"NONE", note.encode(), 1)


@pytest.mark.parametrize(
    ("a", "b", "note"),
    [
        (A, 0j, "NONE"),
        (A, -S * A, "NONE"),
        (A, S * A, "Mode 1: 19.62 Hz, 1.00 %"),
        (3.7 * A, -3.7 * S * A, "Frequency = 19.6200 Hz"),
        (0j, 0j, "Mode 12 in the band 3 Hz to 123.3 Hz"),
    ],
)
def test_an_eigenvalue_in_rad_per_second(tmp_path: Path, a: complex, b: complex, note: str) -> None:
    found = updyn.read_modes(put(tmp_path, complex_mode(S, a, b, note)))
    assert found.frequency == pytest.approx([19.62], rel=1e-5)
    assert found.loss_factor == pytest.approx([2 * RATIO], rel=1e-5)
    assert found.scaled.all() == bool(a)


HZ = S / (2 * np.pi)


@pytest.mark.parametrize(
    "data",
    [
        complex_mode(HZ, A),
        complex_mode(HZ.conjugate(), A.conjugate()),
        complex_mode(HZ, 3.7j, -3.7j * S),
        complex_mode(HZ, note="Mode 1: 19.62 Hz, 1.00 %"),
        complex_mode(HZ, note="Frequency  1.9620E+01"),
    ],
)
def test_an_eigenvalue_in_hz_is_refused(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(FormatError, match=r":10: record 8: .*19\.6.* in Hz; expected rad/s"):
        updyn.read_modes(put(tmp_path, data))


@pytest.mark.parametrize("s", [-HZ.conjugate(), -S.conjugate(), -S])
def test_a_growing_motion_is_refused(tmp_path: Path, s: complex) -> None:
    """The real part of an eigenvalue is negative; some programs write the decay rate there."""
    with pytest.raises(FormatError, match=r":10: record 8: .* unstable; expected a negative"):
        updyn.read_modes(put(tmp_path, complex_mode(s)))


def test_rounding_above_an_undamped_eigenvalue_is_read(tmp_path: Path) -> None:
    found = updyn.read_modes(put(tmp_path, complex_mode(complex(1e-6, S.imag))))
    assert abs(found.loss_factor[0]) < 1e-7


def test_modal_a_that_contradicts_modal_b_is_not_used(tmp_path: Path) -> None:
    with pytest.warns(UpdynWarning, match="modal A of 1 mode .* not used"):
        found = updyn.read_modes(put(tmp_path, complex_mode(S, A, 1j)))
    assert found.frequency == pytest.approx([19.62], rel=1e-5)
    assert not found.scaled.any()


@pytest.mark.parametrize("ratios", [(1.0, 0.0), (1.5, 0.0), (0.0, 2.0), (0.8, 0.5)])
def test_critical_damping_is_refused(tmp_path: Path, ratios: tuple[float, float]) -> None:
    with pytest.raises(FormatError, match=r":10: record 8: .* above critical damping.*per cent"):
        updyn.read_modes(put(tmp_path, dataset(head=(10.0, 1.0, *ratios))))


@pytest.mark.parametrize("ratios", [(-0.01, 0.0), (0.02, -0.001)])
def test_negative_damping_is_refused(tmp_path: Path, ratios: tuple[float, float]) -> None:
    with pytest.raises(FormatError, match=r":10: record 8: damping ratios .* unstable"):
        updyn.read_modes(put(tmp_path, dataset(head=(10.0, 1.0, *ratios))))


@pytest.mark.parametrize(("f", "message"), [(123.276, "in rad/s"), (3.1226, "divided by 2 pi")])
def test_a_frequency_that_its_text_contradicts_is_refused(
    tmp_path: Path, f: float, message: str
) -> None:
    data = dataset(head=(f, 1.0, 0.0, 0.0)).replace(b"NONE", b"Mode 3, 19.62 Hz", 1)
    with pytest.raises(FormatError, match=f":10: record 8: frequency .* line 4: .*{message}"):
        updyn.read_modes(put(tmp_path, data))


def test_other_analyses_are_left_out_with_a_warning(tmp_path: Path) -> None:
    other = dataset(analysis=5, kind=5, head=(10.0,), nodes={1: [1, 0, 0, 0, 0, 0]})
    with pytest.warns(
        UpdynWarning, match="analysis data other than modes are ignored: 1 frequency response"
    ):
        assert len(updyn.read_modes(put(tmp_path, dataset(), other))) == 1


@pytest.mark.parametrize("phase", [0.0, 0.3])
def test_round_trip(tmp_path: Path, phase: float) -> None:
    """Real ones as normal modes, others as complex ones; six digits."""
    rng = np.random.default_rng(4)
    shapes = rng.standard_normal((4, 3)) * np.exp(1j * phase * rng.standard_normal((4, 3)))
    modes = ModeSet(
        [10.0, 20.0, 35.5],
        shapes,
        ["3:X", "3:-RZ", "11:Z", "12:-Y"],
        [0.01, 0.02, 0.005],
        [True, False, True],
        [0.99, 0.8, 1],
    )
    path = tmp_path / "written.unv"
    updyn.write_modes(modes, path)
    again = updyn.read_modes(path)
    order = again.dofs.match(modes.dofs)
    assert again.frequency == pytest.approx(modes.frequency, rel=1e-5)
    assert again.loss_factor == pytest.approx(modes.loss_factor, rel=1e-5)
    assert again.scaled.tolist() == modes.scaled.tolist()
    assert again.quality == pytest.approx(modes.quality, rel=1e-5)
    assert again.shapes[order.index] * order.sign[:, None] == pytest.approx(
        modes.shapes, rel=1e-5, abs=1e-5
    )


@pytest.mark.parametrize("phase", [0.0, 0.3])
def test_deviations_of_shapes_round_trip(tmp_path: Path, phase: float) -> None:
    """Known of two of three modes; signs of labels do not change them."""
    shapes = np.arange(1.0, 13.0).reshape(4, 3) * np.exp(1j * phase)
    std = 0.01 * shapes.real
    std[:, 1] = np.nan
    modes = ModeSet(
        [10.0, 20.0, 35.5], shapes, ["3:X", "3:-RZ", "11:Z", "12:-Y"], scaled=True, std_shapes=std
    )
    path = tmp_path / "written.unv"
    updyn.write_modes(modes, path)
    again = updyn.read_modes(path)
    order = again.dofs.match(modes.dofs)
    assert len(again) == 3
    assert again.std_shapes[order.index] == pytest.approx(std, rel=1e-5, nan_ok=True)
    text = path.read_text(encoding="ascii")
    for old, new, message in [
        (
            "Frequency   3.55000E+01\n         1         0",
            "Frequency   3.0\n         1         0",
            "standard deviations of 'Mode          3 Frequency   3.0' at 3 nodes; the preceding mode is",
        ),
        (
            "         1         0         3         8         2",
            "         1         0         3         8         5",
            "record 6: data type 5 with 6 values per node; expected 2 with 3 or 6",
        ),
    ]:
        assert old in text
        path.write_text(text.replace(old, new, 1), encoding="ascii")
        with pytest.raises(FormatError, match=message):
            updyn.read_modes(path)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_pyuff_reads_what_is_written_and_writes_what_is_read(tmp_path: Path) -> None:
    modes = ModeSet([10.0, 20.0], [[1.0, -0.5], [0.25, 2.0]], ["3:X", "4:Z"], [0.01, 0.02], True)
    path = tmp_path / "written.unv"
    updyn.write_modes(modes, path)
    sets = [s for s in pyuff.UFF(str(path)).read_sets() if s["type"] == 55]
    assert [s["freq"] for s in sets] == [10.0, 20.0]
    assert [s["modal_m"] for s in sets] == [1.0, 1.0]
    assert [s["modal_damp_his"] for s in sets] == [0.01, 0.02]
    assert sets[1]["node_nums"].tolist() == [3, 4]
    assert sets[1]["r1"].tolist() == [-0.5, 0.0]
    assert sets[1]["r3"].tolist() == [0.0, 2.0]

    about: dict[str, Any] = {f"id{i}": "NONE" for i in range(1, 6)}
    about |= {
        "model_type": 1,
        "data_ch": 2,
        "spec_data_type": 8,
        "n_data_per_node": 3,
        "load_case": 1,
        "mode_n": 1,
    }
    shape = np.array([1.0 + 0.5j, -2.0 + 0.25j])
    rest = {"r2": np.zeros(2, complex), "r3": np.zeros(2, complex), "node_nums": [7, 9]}
    normal = {
        "analysis_type": 2,
        "data_type": 2,
        "freq": 12.5,
        "modal_m": 4.0,
        "modal_damp_vis": 0.02,
        "modal_damp_his": 0.0,
    }
    complex_ = {
        "analysis_type": 3,
        "data_type": 5,
        "eig": -1.0 + 99.0j,
        "modal_a": 198.0j,
        "modal_b": 0j,
    }
    theirs = tmp_path / "pyuff.unv"
    file = pyuff.UFF(str(theirs))
    file.write_sets(
        pyuff.prepare_55(
            **about, **normal, r1=shape.real, **{k: np.real(v) for k, v in rest.items()}
        ),
        "add",
    )
    file.write_sets(pyuff.prepare_55(**about, **complex_, r1=shape, **rest), "add")
    read = updyn.read_modes(theirs)
    assert read.dofs.labels == ["7:X", "9:X"]
    assert read.frequency == pytest.approx([12.5, abs(-1 + 99j) / (2 * np.pi)], rel=1e-5)
    assert read.loss_factor == pytest.approx([0.04, 2 / abs(-1 + 99j)], rel=1e-5)
    assert read.shapes[:, 0] == pytest.approx(shape.real / 2.0)
    assert read.shapes[:, 1] == pytest.approx(shape)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (uff.text(151, "x"), r"holds no modes \(dataset 55 or 2414 of analysis type 2, 3 or 7\); it holds dataset 151"),
        (dataset(analysis=4), "holds no modes .* it holds 1 of analysis data, transient"),
        (dataset(characteristic=1, width=1), ":8: record 6: data characteristic 1 with 1 values per node; expected 2"),
        (dataset(kind=3), ":8: record 6: data type 3; expected 2"),
        (dataset(head=(10.0, 0.0, 0.0)), ":9: record 7: 3 real parameters; expected at least 4"),
        (dataset(head=(-1.0, 0, 0, 0)), ":10: record 8: frequency -1 Hz"),
        (dataset(head=(1.0, -2.0, 0, 0)), ":10: record 8: frequency 1 Hz and modal mass -2"),
        (dataset(analysis=3, kind=5, head=(-1.0, 0, 0, 0, 0, 0), nodes={1: [1] * 6}), ":10: .* does not oscillate"),
        (dataset(nodes={1: [1.0, 2.0]}), ":12: record 10: expected 3 numbers, found 2"),
        (dataset(nodes={1: [np.nan, 0, 0]}), ":12: record 10: expected a number, found 'NAN'"),
        (dataset(nodes={1: [0.0, 0, 0]}), ":2: dataset 55: the shape is zero"),
        (dataset(nodes={}), ":2: dataset 55: the shape is zero"),
        (dataset()[:-20] + b"\n    -1\n", ":14: record 10: expected 3 numbers, found 2"),
        (dataset().replace(b"\n         2\n", b"\n         1\n"), ":13: dataset 55: node 1 occurs twice"),
        (dataset().replace(b"\n         2\n", b"\n       two\n"), ":13: record 9, node: expected a whole number"),
        (dataset().replace(b"\n         2\n", b"\n        123\n"), ":13: record 9, node: .* extends beyond them"),
        (dataset().replace(b"\n         2\n", b"\n" + b"2" * 99 + b"\n"), ":13: record 9: expected only the node"),
    ],
)  # fmt: skip
def test_bad_files_are_refused(tmp_path: Path, data: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        updyn.read_modes(put(tmp_path, data))


def test_a_note_about_quality_is_no_number(tmp_path: Path) -> None:
    for line in ("quality E", "quality -", "quality 0.5 or so", "high quality 3"):
        modes = updyn.read_modes(
            put(tmp_path, dataset().replace(b"NONE\n" * 2, f"{line}\n".encode() * 2, 1))
        )
        assert np.isnan(modes.quality).all()


def test_touching_numbers_are_told_by_their_columns(tmp_path: Path) -> None:
    rows = {1: [-1.5e-100, -2.5e-100, -3.5e-100]}  # 13 columns, no blank between them
    touching = dataset(nodes=rows).replace(b" -1.50000E-100", b"-1.50000E-100")
    assert updyn.read_modes(put(tmp_path, touching)).shapes[:, 0].tolist() == [
        -1.5e-100,
        -2.5e-100,
        -3.5e-100,
    ]


def test_modes_of_no_file_or_format(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="no such file"):
        updyn.read_modes(tmp_path / "modes.unv")
    modes = ModeSet([10.0], [[1.0]], [f"{10**11}:X"])
    with pytest.raises(FormatError, match="does not fit the ten columns"):
        updyn.write_modes(modes, tmp_path / "modes.unv")
    with pytest.raises(FormatError, match="write_modes"):
        updyn.write_modes(modes, tmp_path / "modes.npz")
