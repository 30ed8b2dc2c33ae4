"""Writes the malformed FRF files of the folder `frf`, each wrong in one way. Run it to make them anew.

    python tests/data/bad/make_bad_frf.py

`tests/io/test_bad_frf.py` says what is expected of each, and that the files are what this script
writes."""

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "io"))

import uff_samples as uff  # noqa: E402

Y = np.array([1.5 - 2j, -0.25 + 1e-3j, 3e4 + 7j, -1e-6 - 1j / 3])
GOOD = uff.binary58(Y)
TEXT = uff.ascii58(Y)
NODES = uff.nodes15((1, 0, 0, 0, 0, 0), (2, 0, 5, 1, 0, 0), (30, 0, 0, 2, 0, 0))
TILTED = uff.systems2420((5, 0, [[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]], (0, 0, 0)))
CSV = "# quantity: accelerance\nfreq_Hz,H(1:Z/1:Z) re,H(1:Z/1:Z) im\n10,1,2\n20,3,4\n"


def without_last_line(data: bytes) -> bytes:
    return data[: data.rindex(b"    -1")]


def swapped(data: bytes, old: str, new: str) -> bytes:
    assert data.count(old.encode()) == 1, (old, data.count(old.encode()))
    return data.replace(old.encode(), new.encode())


def uffs() -> dict[str, bytes]:
    """Universal files."""
    nan = Y.copy()
    nan[2] = np.nan
    return {
        "empty.uff": b"",
        "blank.uff": b"\n\n   \n",
        "text.uff": b"Measured on a Monday, see the logbook.\n",
        "binary_rubbish.uff": bytes(range(256)) * 4,
        "no_functions.uff": NODES + TILTED,
        "other_functions.uff": uff.ascii58(Y.real, kind=1, types=(17, 12, 0)),
        "number_missing.uff": b"    -1\n  abc\n" + TEXT,
        "not_closed.uff": without_last_line(TEXT),
        "delimiter_missing.uff": without_last_line(TEXT) + uff.ascii58(Y, (2, 3)),
        "delimiter_superfluous.uff": TEXT + b"    -1\n" + TEXT,
        "text_cut_short.uff": TEXT[: len(TEXT) - 60] + b"\n    -1\n",
        "header_cut_short.uff": uff.text(58, *uff.records()[:6]),
        "binary_cut_short.uff": GOOD[:-40],
        "binary_cut_in_header.uff": GOOD[:400],
        "byte_count_wrong.uff": uff.binary58(Y, n_bytes=56),
        "byte_order_wrong.uff": swapped(GOOD, "b     1", "b     7"),
        "byte_order_of_data_wrong.uff": swapped(GOOD, "b     1", "b     2"),
        "floating_format_vax.uff": swapped(GOOD, "     2          11", "     1          11"),
        "binary_head_missing.uff": uff.binary58(Y, head="b"),
        "text_lines_wrong.uff": swapped(GOOD, "     2          11", "     2          12"),
        "binary_through_text_mode.uff": GOOD.replace(GOOD[-70:-40], GOOD[-70:-40] + b"\r\n\r"),
        "points_too_many.uff": uff.ascii58(Y, points=5),
        "points_too_few.uff": uff.ascii58(Y, points=3),
        "points_too_few_binary.uff": uff.binary58(Y, points=3),
        "points_none.uff": uff.ascii58(Y, points=0),
        "points_absurd_binary.uff": uff.binary58(Y, points=999999999),
        "ordinate_type_wrong.uff": uff.text(58, *uff.records(ordinate=7), "1.0"),
        "spacing_wrong.uff": uff.text(58, *uff.records(even=3), "1.0"),
        "number_garbled.uff": swapped(TEXT, "7.00000E+00", "7.0O000E+00"),
        "nan_text.uff": swapped(TEXT, " 7.00000E+00", "         NaN"),
        "nan_binary.uff": uff.binary58(nan),
        "inf_abscissa.uff": uff.binary58(Y, x=[1, 2, 3, np.inf]),
        "abscissa_decreases.uff": uff.ascii58(Y, x=[1, 3, 2, 4]),
        "abscissa_repeats.uff": uff.ascii58(Y, x=[1, 2, 2, 4]),
        "abscissa_increment_zero.uff": uff.ascii58(Y, step=0.0),
        "abscissa_negative.uff": uff.ascii58(Y, start=-1.0),
        "abscissa_time.uff": uff.ascii58(Y, types=(17, 12, 13), units=("s", "NONE", "NONE")),
        "abscissa_rpm.uff": uff.ascii58(Y, types=(19, 12, 13), units=("rpm", "NONE", "NONE")),
        "abscissa_unit_unknown.uff": uff.ascii58(Y, units=("order", "NONE", "NONE")),
        "node_garbled.uff": uff.text(58, *uff.records((7777, 3)), "1.0").replace(b"7777", b"7x77"),
        "direction_garbled.uff": (
            uff.text(58, *uff.records((7777, 3)), "1.0").replace(b"7777   3", b"7777  +Z")
        ),
        "direction_9.uff": uff.ascii58(Y, (1, 9)),
        "direction_0.uff": uff.ascii58(Y, (17, 0)),
        "node_not_in_geometry.uff": (
            NODES.replace(b"5         8", b"0         8") + uff.ascii58(Y, (3, 1))
        ),
        "oblique.uff": TILTED + NODES + uff.ascii58(Y, (2, 1), (1, 1)),
        "system_not_defined.uff": NODES + uff.ascii58(Y, (2, 1), (1, 1)),
        "system_not_orthogonal.uff": uff.systems2420((5, 0, np.ones((3, 3)), (0, 0, 0))) + TEXT,
        "node_twice.uff": uff.nodes15((1, 0, 0, 0, 0, 0), (1, 0, 0, 1, 0, 0)) + TEXT,
        "node_position_garbled.uff": (
            swapped(uff.nodes15((1, 0, 0, 0.5, 0, 0)), "5.0", "5.x") + TEXT
        ),
        "trace_line_to_nowhere.uff": uff.nodes15((1, 0, 0, 0, 0, 0)) + uff.trace82(1, 4) + TEXT,
        "units_contradict.uff": uff.units(1, 1000.0, 1000.0) + TEXT,
        "units_change.uff": uff.units(1, 1.0, 1.0) + uff.units(5, 1000.0, 1000.0) + TEXT,
        "unit_unknown.uff": uff.ascii58(Y, units=("Hz", "EU", "N")),
        "unit_of_another_kind.uff": uff.ascii58(Y, units=("Hz", "N", "m/s^2")),
        "unit_contradicts_164.uff": uff.units(10, 1e3, 1.0)
        + uff.ascii58(Y, units=("Hz", "m/s^2", "N")),
        "quantity_unknown.uff": uff.ascii58(Y, types=(18, 0, 0)),
        "quantity_mixed.uff": uff.ascii58(Y) + uff.ascii58(Y, (2, 3), types=(18, 11, 13)),
        "force_over_motion.uff": uff.ascii58(Y, types=(18, 13, 12)),
        "strain_over_force.uff": uff.ascii58(Y, types=(18, 3, 13)),
        "motion_over_motion.uff": uff.ascii58(Y, types=(18, 12, 12)),
        "magnitude_only.uff": uff.ascii58(np.abs(Y)),
        "duplicate_pair.uff": uff.ascii58(Y, (4, 1)) + uff.ascii58(2 * Y, (4, -1)),
        "matrix_incomplete.uff": b"".join(
            uff.ascii58(Y, (a, 3), (b, 3)) for a, b in ((1, 1), (2, 1), (1, 2))
        ),
        "lines_differ.uff": uff.ascii58(Y) + uff.ascii58(Y, (2, 3), step=0.25),
        "lines_differ_in_number.uff": uff.ascii58(Y) + uff.ascii58(Y[:3], (2, 3)),
        "coherence_above_1.uff": TEXT + uff.ascii58([1.0, 1.2, 0.5, 0.5], kind=6, types=(18, 0, 0)),
        "coherence_complex.uff": TEXT + uff.ascii58(Y / 1e5, kind=6, types=(18, 0, 0)),
        "latin1_title_cut.uff": uff.ascii58(Y, title="Pruefstand").replace(b"ue", b"\xfc")[:300],
    }


def table(*columns: str, row: str | None = None) -> str:
    """One line of numbers under columns such as "1:Z/1:Z re"."""
    names = [f"H({pair}) {kind}" for pair, kind in (c.split() for c in columns)]
    return "\n".join(
        [
            "# quantity: mobility",
            ",".join(["freq_Hz", *names]),
            row or "1" + ",0.5" * len(names),
            "",
        ]
    )


def tables() -> dict[str, bytes]:
    """Tables in text."""
    out = {
        "empty.csv": "",
        "comments_only.csv": "# quantity: accelerance\n",
        "no_quantity.csv": CSV.split("\n", 1)[1],
        "quantity_inverse.csv": CSV.replace("accelerance", "apparent mass"),
        "quantity_misspelt.csv": CSV.replace("accelerance", "acelerance"),
        "quantity_twice.csv": "# quantity: mobility\n" + CSV,
        "first_column.csv": CSV.replace("freq_Hz", "frequency"),
        "column_name.csv": CSV.replace("H(1:Z/1:Z) im", "H11 im"),
        "column_kind.csv": CSV.replace("1:Z) im", "1:Z) imag"),
        "column_twice.csv": CSV.replace("1:Z) im", "1:Z) re"),
        "column_dof.csv": CSV.replace("1:Z/1:Z) im", "1:W/1:Z) im"),
        "column_im_missing.csv": table("1:Z/1:Z re"),
        "column_kinds_mixed.csv": CSV.replace("1:Z) im", "1:Z) phase_deg"),
        "columns_none.csv": table(),
        "pair_missing.csv": table("1:Z/1:Z re", "1:Z/1:Z im", "2:Z/3:Z re", "2:Z/3:Z im"),
        "both_senses.csv": table("1:Z/1:Z re", "1:Z/1:Z im", "1:-Z/1:Z re", "1:-Z/1:Z im"),
        "cell_missing.csv": CSV.replace("20,3,4", "20,3"),
        "cell_empty.csv": CSV.replace("20,3,4", "20,,4"),
        "cell_text.csv": CSV.replace("20,3,4", "20,3,four"),
        "cell_nan.csv": CSV.replace("20,3,4", "20,3,nan"),
        "decimal_comma.csv": CSV.replace(",", ";").replace("20;3;4", "20;3,5;4.5"),
        "decimal_comma_in_comma_table.csv": CSV.replace("20,3,4", "20,0,3,5,4,1"),
        "lines_decrease.csv": CSV.replace("20,3,4", "5,3,4"),
        "no_lines.csv": CSV.split("10,")[0],
        "abs_negative.csv": table("1:Z/1:Z phase_deg", "1:Z/1:Z abs", row="10,90,-1"),
        "coherence_above_1.csv": table("1:Z/1:Z re", "1:Z/1:Z im", "1:Z/1:Z coh", row="10,1,2,1.5"),
        "coherence_partial.csv": table("1:Z/1:Z re", "1:Z/1:Z im", "2:Z/1:Z re", "2:Z/1:Z im", "2:Z/1:Z coh"),
        "averages_garbled.csv": "# averages: many\n" + CSV,
    }  # fmt: skip
    return {name: text.encode() for name, text in out.items()} | {
        "latin1.csv": "# Prüfstand\n".encode("latin-1") + CSV.encode()
    }


def files() -> dict[str, bytes]:
    """All of them, by name."""
    return uffs() | tables()


if __name__ == "__main__":
    folder = HERE / "frf"
    folder.mkdir(exist_ok=True)
    for name, data in files().items():
        (folder / name).write_bytes(data)
