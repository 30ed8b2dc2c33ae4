"""`updyn.read_geometry` with a unit, and Nastran decks of which only the positions are wanted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import uff_samples as uff
import updyn
from updyn.errors import FormatError, OptionError

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
NODES = uff.nodes15((1, 0, 0, 0.0, 0.0, 0.0), (2, 0, 0, 1.5, 0.0, -2.0))
TABLE = "node,x,y,z,xx,xy,xz,yx,yy,yz,zx,zy,zz\n1,0,0,0,0,1,0,-1,0,0,0,0,1\n2,1.5,0,-2,1,0,0,0,1,0,0,0,1\n"


@pytest.mark.parametrize("unit", METRES)
@pytest.mark.parametrize("kind", ["csv", "unv"])
def test_positions_in_a_unit(tmp_path: Path, unit: str, kind: str) -> None:
    path = tmp_path / f"nodes.{kind}"
    path.write_bytes(NODES if kind == "unv" else TABLE.encode())
    geometry = updyn.read_geometry(path, unit=unit)
    expected = np.array([[0.0, 0.0, 0.0], [1.5, 0.0, -2.0]]) * METRES[unit]
    np.testing.assert_allclose(geometry.xyz, expected, rtol=1e-15)
    if kind == "csv":  # directions have no unit
        assert geometry.axes is not None
        np.testing.assert_array_equal(geometry.axes, updyn.read_geometry(path).axes)


def test_origins_of_systems_in_a_unit(tmp_path: Path) -> None:
    """A cylindrical system at (100, 0, 0): angles stay degrees."""
    system = uff.text(
        2420,
        f"{1:10d}",
        "NONE",
        f"{5:10d}{1:10d}{8:10d}",
        "CS5",
        *(
            "".join(f"{v:25.16E}" for v in row)
            for row in ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0), (100.0, 0, 0))
        ),
    )
    path = tmp_path / "nodes.unv"
    path.write_bytes(system + uff.nodes15((1, 5, 0, 50.0, 90.0, 7.0)))
    xyz = updyn.read_geometry(path, unit="mm").xyz
    np.testing.assert_allclose(xyz, [[0.1, 0.05, 0.007]], atol=1e-15)


def test_a_file_that_says_its_unit(tmp_path: Path) -> None:
    path = tmp_path / "nodes.unv"
    path.write_bytes(NODES + uff.units(5, 1e3, 1e3))
    expected = [[0.0, 0.0, 0.0], [0.0015, 0.0, -0.002]]
    np.testing.assert_allclose(updyn.read_geometry(path).xyz, expected, rtol=1e-15)
    np.testing.assert_allclose(updyn.read_geometry(path, unit="mm").xyz, expected, rtol=1e-15)
    with pytest.raises(FormatError, match=r":8: unit 'in' contradicts dataset 164") as caught:
        updyn.read_geometry(path, unit="in")
    assert caught.value.key == ("unit",)


@pytest.mark.parametrize("unit", ["mn", "inch", 3, None])
def test_unknown_units(tmp_path: Path, unit: object) -> None:
    path = tmp_path / "nodes.csv"
    path.write_text(TABLE)
    with pytest.raises(OptionError, match=r"unit .*(did you mean|valid: 'm', 'cm')"):
        updyn.read_geometry(path, unit=unit)


# -- Nastran ------------------------------------------------------------------------------------
DECK = """SOL 103
CEND
BEGIN BULK
GRID,1,,0.,0.,0.
GRID,2,,1.5,0.,0.
GRID,3,,1.5,2.,0.
CBAR,1,7,1,2,0.,0.,1.
CBAR,2,7,2,3,0.,0.,1.
CWELD,9,3,4,5
FASTNER,1,2,3
PBARX,7,1
MATX,1,2.
RBE2,5,99,123,98
SPC1,1,123,97
ENDDATA
"""


def test_cards_that_say_nothing_of_positions_are_passed_over(tmp_path: Path) -> None:
    """Unknown elements, materials and properties that are not there, ties between other grids."""
    path = tmp_path / "wing.bdf"
    path.write_text(DECK)
    geometry = updyn.read_geometry(path, unit="mm")
    np.testing.assert_allclose(geometry.xyz, [[0, 0, 0], [0.0015, 0, 0], [0.0015, 0.002, 0]])
    assert geometry.lines.tolist() == [[1, 2], [2, 3]]
    with pytest.raises(FormatError, match=r":9: card CWELD is not known"):
        updyn.read_model(path)


@pytest.mark.parametrize(
    ("card", "said"),
    [
        ("GRIDB,9,,,,0.", r":4: card GRIDB is not known and may define positions .* 'GRID'"),
        ("CORD3G,9,1,1,1,1", r":4: card CORD3G is not known and may define positions .* 'CORD"),
        ("CBAR,9,7,1,8", r":4: CBAR 9: no grid 8; nearest: "),
        ("GRID,1,,0.,0.,0.", "GRID 1 is defined twice"),
        ("GRID,4,6,0.,0.,0.", ":4: .*6"),
    ],
)
def test_positions_that_are_not_clear(tmp_path: Path, card: str, said: str) -> None:
    path = tmp_path / "wing.bdf"
    path.write_text(DECK.replace("BEGIN BULK\n", f"BEGIN BULK\n{card}\n"))
    with pytest.raises(FormatError, match=said):
        updyn.read_geometry(path)


def test_a_card_can_still_be_left_out(tmp_path: Path) -> None:
    path = tmp_path / "wing.bdf"
    path.write_text(DECK.replace("BEGIN BULK\n", "BEGIN BULK\nGRIDB,9,,,,0.\n"))
    assert len(updyn.read_geometry(path, ignore=["gridb"]).nodes) == 3
