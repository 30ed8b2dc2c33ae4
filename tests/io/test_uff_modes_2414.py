"""Modes in datasets 2414 of universal files: field by field, against dataset 55, pyuff's writer, bad files."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyuff

import uff_samples as uff
import updyn
from updyn.errors import FormatError, UpdynWarning

NORMAL = (0.0, 10.0, 3947.84, 4.0, 0.01, 0.003)
NONE = (0.0,) * 6


def dataset(
    *,
    location: int = 1,
    analysis: int = 2,
    characteristic: int = 2,
    result: int = 8,
    kind: int = 2,
    width: int = 3,
    first: Sequence[float] = NORMAL,
    second: Sequence[float] = NONE,
    nodes: dict[int, Sequence[float]] | None = None,
) -> bytes:
    """A dataset 2414 by the columns of the format."""
    values = {1: [1.0, 0.0, -2.0], 2: [0.5, 0.0, 1.0]} if nodes is None else nodes
    lines = [f"{1:10d}", "Mode 1", f"{location:10d}", *["NONE"] * 5]
    about = (1, analysis, characteristic, result, kind, width)
    for whole in (about, (1, 0, 1, 0, 1, 1, 0, 0), (0, 0)):
        lines.append("".join(f"{v:10d}" for v in whole))
    for real in (first, second):
        lines.append("".join(f"{v:13.5E}" for v in real))
    for node, row in values.items():
        lines.append(f"{node:10d}")
        lines += ["".join(f"{v:13.5E}" for v in row[i : i + 6]) for i in range(0, len(row), 6)]
    return uff.text(2414, *lines)


def put(tmp_path: Path, *parts: bytes) -> Path:
    path = tmp_path / "modes.unv"
    path.write_bytes(b"".join(parts))
    return path


def test_normal_modes(tmp_path: Path) -> None:
    second = dataset(
        first=(0.0, 20.0, 0.0, 0.0, 0.0, 0.0), nodes={1: [0.0, 0.0, 3.0], 2: [2.0, 0.0, 0.0]}
    )
    modes = updyn.read_modes(put(tmp_path, dataset(), second))
    assert modes.dofs.labels == ["1:X", "1:Z", "2:X", "2:Z"]
    assert modes.frequency.tolist() == [10.0, 20.0]
    assert modes.loss_factor[0] == pytest.approx(2 * 0.01 + 0.003)
    assert np.isnan(modes.loss_factor[1])
    assert modes.scaled.tolist() == [True, False]
    assert modes.shapes[:, 0].tolist() == [0.5, -1.0, 0.25, 0.5]  # over the root of 4
    assert modes.shapes[:, 1].tolist() == [0.0, 3.0, 2.0, 0.0]


def test_as_dataset_55_with_rotations_and_units(tmp_path: Path) -> None:
    """The same modes in millimetres in datasets 55 and 2414."""
    rng = np.random.default_rng(7)
    shape = {n: rng.standard_normal(6).round(5).tolist() for n in (3, 11, 12)}
    lines = ["Mode", *["NONE"] * 4]
    lines.append("".join(f"{v:10d}" for v in (1, 2, 3, 8, 2, 6)))
    lines.append("".join(f"{v:10d}" for v in (2, 4, 1, 1)))
    lines.append("".join(f"{v:13.5E}" for v in (10.0, 4.0, 0.01, 0.003)))
    for node, row in shape.items():
        lines += [f"{node:10d}", "".join(f"{v:13.5E}" for v in row)]
    expected = updyn.read_modes(put(tmp_path, uff.units(5, 1e3, 1e3), uff.text(55, *lines)))
    found = updyn.read_modes(
        put(tmp_path, uff.units(5, 1e3, 1e3), dataset(characteristic=3, width=6, nodes=shape))
    )
    assert found.dofs == expected.dofs
    np.testing.assert_array_equal(found.shapes, expected.shapes)
    np.testing.assert_array_equal(found.frequency, expected.frequency)
    np.testing.assert_array_equal(found.loss_factor, expected.loss_factor)


@pytest.mark.parametrize(("analysis", "scaled"), [(3, True), (7, False)])
def test_complex_modes(tmp_path: Path, analysis: int, scaled: bool) -> None:
    s, a = complex(-0.3, 62.8), complex(0.1, 2.0)
    second = (s.real, s.imag, a.real, a.imag, 0.0, 0.0)
    rows = {5: [1.0, 0.1, 0.0, 0.0, -2.0, 0.3]}
    modes = updyn.read_modes(
        put(tmp_path, dataset(analysis=analysis, kind=5, first=NONE, second=second, nodes=rows))
    )
    assert modes.frequency == pytest.approx([abs(s) / (2 * np.pi)], rel=1e-5)
    assert modes.loss_factor == pytest.approx([0.6 / abs(s)], rel=1e-5)
    factor = np.sqrt(2j * s.imag / a) if scaled else 1.0
    assert modes.shapes[:, 0] == pytest.approx(np.array([1.0 + 0.1j, -2.0 + 0.3j]) * factor)
    assert modes.scaled.tolist() == [scaled]


@pytest.mark.parametrize(("result", "scaled"), [(8, True), (95, True), (11, False), (12, False)])
def test_kinds_of_motion(tmp_path: Path, result: int, scaled: bool) -> None:
    path = put(tmp_path, dataset(result=result))
    if scaled:
        assert updyn.read_modes(path).scaled.all()
        return
    with pytest.warns(UpdynWarning, match="modal mass or modal A of 1 mode .* not used"):
        assert not updyn.read_modes(path).scaled.any()


S = complex(-0.628, 62.8)  # 1 % of critical damping, 9.9955 Hz


@pytest.mark.parametrize(
    "first",
    [
        (0.0, 9.99552, 0.0, 0.0, 0.01, 0.0),
        (0.0, 9.99502, 0.0, 0.0, 0.0, 0.02),  # the damped frequency
        (0.0, 9.99552, 0.0, 0.0, 0.01, 0.02),  # the same damping twice
        NONE,
    ],
)
def test_frequency_and_damping_beside_an_eigenvalue(tmp_path: Path, first: Sequence[float]) -> None:
    second = (S.real, S.imag, 0.0, 0.0, 0.0, 0.0)
    data = dataset(analysis=3, kind=5, first=first, second=second, nodes={5: [1.0] * 6})
    found = updyn.read_modes(put(tmp_path, data))
    assert found.frequency == pytest.approx([abs(S) / (2 * np.pi)], rel=1e-5)
    assert found.loss_factor == pytest.approx([0.02], rel=1e-3)


@pytest.mark.parametrize(
    ("first", "s", "message"),
    [
        ((0.0, 62.8031, 0, 0, 0.01, 0), S, ":14: record 12: frequency 62.8031 Hz contradicts the eigenvalue .*9.99.*; expected Hz here and rad/s"),
        ((0.0, 9.99552, 0, 0, 0.01, 0), S / (2 * np.pi), ":14: record 12: frequency 9.99552 Hz contradicts the eigenvalue .*1.59"),
        ((0.0, 9.99552, 0, 0, 0.05, 0), S, ":14: record 12: damping ratios 0.05 and 0 contradict the eigenvalue .*0.00999"),
        ((0.0, 9.99552, 0, 0, 1.0, 0), S, ":14: record 12: damping ratios 1 and 0 contradict"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("analysis", [3, 7])
def test_contradictions_beside_an_eigenvalue(
    tmp_path: Path, first: Sequence[float], s: complex, message: str, analysis: int
) -> None:
    second = (s.real, s.imag, 0.0, 0.0, 0.0, 0.0)
    data = dataset(analysis=analysis, kind=5, first=first, second=second, nodes={5: [1.0] * 6})
    with pytest.raises(FormatError, match=message):
        updyn.read_modes(put(tmp_path, data))


@pytest.mark.parametrize(
    ("frequency", "ratio", "is_right"),
    [
        (1.009, 0.01, True),
        (1.011, 0.01, False),  # more than 1 %
        (1.0, 0.0111, True),
        (1.0, 0.0113, False),  # more than 0.001 and 2 %
    ],
)
def test_rounded_fields_beside_an_eigenvalue(
    tmp_path: Path, frequency: float, ratio: float, is_right: bool
) -> None:
    first = (0.0, frequency * abs(S) / (2 * np.pi), 0.0, 0.0, ratio, 0.0)
    second = (S.real, S.imag, 0.0, 0.0, 0.0, 0.0)
    data = dataset(analysis=3, kind=5, first=first, second=second, nodes={5: [1.0] * 6})
    with nullcontext() if is_right else pytest.raises(FormatError, match="contradict"):
        updyn.read_modes(put(tmp_path, data))


@pytest.mark.parametrize(
    ("eigenvalue", "is_right"),
    [
        (3947.84, True),
        (62.8319, True),
        (100.0, False),
        (9e4, False),
        (1.019 * 3947.84, True),
        (1.021 * 3947.84, False),  # more than 2 %
    ],
)
def test_the_eigenvalue_of_a_normal_mode(tmp_path: Path, eigenvalue: float, is_right: bool) -> None:
    """The square of the angular frequency, or that itself."""
    path = put(tmp_path, dataset(first=(0.0, 10.0, eigenvalue, 0.0, 0.0, 0.0)))
    if is_right:
        assert updyn.read_modes(path).frequency.tolist() == [10.0]
        return
    with pytest.raises(FormatError, match=r":14: record 12: frequency 10 Hz .* eigenvalue"):
        updyn.read_modes(path)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"result": 9}, "1 result type 9 of modes"),
        ({"result": 2, "characteristic": 4, "width": 6}, "1 result type 2 of modes"),
        ({"location": 2}, "1 modes on elements"),
        ({"location": 3, "result": 2}, "1 modes at nodes on elements"),
        ({"analysis": 5}, "1 frequency response"),
        ({"analysis": 9}, "1 analysis type 9"),
    ],
)
def test_other_data_are_left_out_with_a_warning(
    tmp_path: Path, other: dict[str, int], said: str
) -> None:
    with pytest.warns(UpdynWarning, match=f"analysis data other than modes are ignored: {said}"):
        assert len(updyn.read_modes(put(tmp_path, dataset(), dataset(**other)))) == 1


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_what_pyuff_writes(tmp_path: Path) -> None:
    rows: dict[str, Any] = {f"record10_field{i}": 0 for i in range(1, 9)}
    rows |= {f"record11_field{i}": 0 for i in range(1, 9)}
    rows |= {f"record12_field{i}": v for i, v in enumerate(NORMAL, 1)}
    rows |= {f"record13_field{i}": 0 for i in range(1, 7)}
    about = pyuff.prepare_2414(
        analysis_dataset_label=1,
        analysis_dataset_name="Mode",
        dataset_location=1,
        **{f"id{i}": "NONE" for i in range(1, 6)},
        model_type=1,
        analysis_type=2,
        data_characteristic=2,
        result_type=8,
        data_type=5,
        number_of_data_values_for_the_data_component=3,
        node_nums=np.array([7, 9]),
    )
    about["data_at_node"] = [[1.0, 0.5, 0.0, 0.0, 0.25, 0.0], [3.0, -1.0, 0.0, 0.0, -2.0, 0.75]]
    path = tmp_path / "pyuff.unv"
    pyuff.UFF(str(path)).write_sets(about | rows, "add")
    modes = updyn.read_modes(path)
    assert modes.dofs.labels == ["7:X", "7:Z", "9:X", "9:Z"]
    assert modes.frequency.tolist() == [10.0]
    assert modes.shapes[:, 0] * 2.0 == pytest.approx([1 + 0.5j, 0.25, 3 - 1j, -2 + 0.75j])


MODE_55 = uff.text(
    55,
    *["NONE"] * 5,
    "".join(f"{v:10d}" for v in (1, 2, 2, 8, 2, 3)),
    "".join(f"{v:10d}" for v in (2, 4, 1, 1)),
    "".join(f"{v:13.5E}" for v in (10.0, 0.0, 0.0, 0.0)),
    f"{1:10d}",
    "".join(f"{v:13.5E}" for v in (1.0, 0.0, 0.0)),
)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (dataset(location=2), "holds no modes .* it holds 1 of analysis data, modes on elements"),
        (MODE_55 + dataset(), "modes in dataset 2414, and in dataset 55 on line 2"),
        (dataset(characteristic=1, width=1), ":11: record 9: data characteristic 1 with 1 values"),
        (dataset(kind=3), ":11: record 9: data type 3; expected 2"),
        (dataset(first=(0.0, -1.0, 0, 0, 0, 0)), ":14: record 12: frequency -1 Hz"),
        (dataset(first=(0.0, 0.0, 400.0, 0, 0, 0)), ":14: record 12: frequency 0 Hz with"),
        (dataset(first=(0.0, 10.0)), ":14: record 12: expected 6 numbers, found 2"),
        (dataset(analysis=3, kind=5, nodes={1: [1] * 6}), ":15: record 13: .* does not oscillate"),
        (dataset(nodes={1: [1.0, 2.0]}), ":17: record 15: expected 3 numbers, found 2"),
        (dataset(nodes={1: [np.nan, 0, 0]}), ":17: record 15: expected a number, found 'NAN'"),
        (dataset(nodes={1: [0.0, 0, 0]}), ":2: dataset 2414: the shape is zero"),
        (dataset().replace(b"\n         2\n", b"\n         1\n"), "dataset 2414: node 1 occurs twice"),
        (dataset().replace(b"\n         2\n", b"\n       two\n"), ":18: record 14, node: expected a whole"),
        (uff.text(2414, "1", "x"), ":2: dataset 2414: 2 lines; expected at least 13"),
    ],
)  # fmt: skip
def test_bad_files_are_refused(tmp_path: Path, data: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        updyn.read_modes(put(tmp_path, data))


def test_a_rigid_mode(tmp_path: Path) -> None:
    rigid = dataset(first=(0.0, 0.0, -1e-6, 1.0, 0.0, 0.0))
    assert updyn.read_modes(put(tmp_path, rigid)).frequency.tolist() == [0.0]
