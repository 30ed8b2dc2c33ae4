"""What docs/records.md shows, with the file that it speaks of."""

from __future__ import annotations

import lzma
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import updyn
from places import DATA, ROOT
from updyn.cli import main
from updyn.signals import quality

PAGE = (ROOT / "docs" / "records.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(python|text|toml|console)\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return the current folder, with the records in it."""
    monkeypatch.chdir(tmp_path)
    packed = (DATA / "cases" / "impact.lvm.xz").read_bytes()
    (tmp_path / "impact.lvm").write_bytes(lzma.decompress(packed))
    return tmp_path


def test_the_command_prints_what_it_says(folder, capsys):
    at = next(i for i, (language, _) in enumerate(BLOCKS) if language == "toml")
    (_, job), (_, command), (_, printed) = BLOCKS[at : at + 3]
    (folder / "job.toml").write_text(job, encoding="utf-8")
    assert main(shlex.split(command)[1:]) == 0
    assert capsys.readouterr().out == printed
    assert updyn.read_frf(folder / "test.nc").responses.labels == ["2:Z"]


def test_the_first_example_prints_what_it_says(folder, capsys):
    (_, example), (_, printed) = BLOCKS[:2]
    seen: dict[str, object] = {}
    exec(example, seen)
    assert capsys.readouterr().out == printed
    frf = updyn.read_frf(folder / "test.nc")
    said = re.search(r"is ([\d.]+) with the first hit and ([\d.]+) without it", PAGE)
    assert said is not None
    assert f"{np.median(frf.coherence):.3f}" == said[2]
    whole = updyn.estimate_frf(
        seen["records"],
        {"Force (Trigger)": "1:Z"},
        responses={"Acceleration (Trigger)": "2:Z"},
        band=(100, 5000),
    )
    assert f"{np.median(whole.coherence):.3f}" == said[1]


def test_a_table_of_ones_own_with_units_and_factors(tmp_path, monkeypatch):
    formats = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
    table = re.search(r"```text\n(time,hammer.*?)```", formats, re.DOTALL)
    assert table is not None
    (tmp_path / "hit.csv").write_text(table[1].replace(" [N]", ""), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    seen: dict[str, object] = {"updyn": updyn}
    exec(next(text for _, text in BLOCKS if "factors=" in text), seen)
    records = seen["records"]
    assert records["unit"].values.tolist() == ["N", "g"]
    assert records.values[0].tolist() == [
        [22.5 * f for f in (0.1, 35.2, 28.9)],
        [-0.02, 0.31, 0.87],
    ]


def test_arrays_of_ones_own_are_records():
    seen: dict[str, object] = {}
    exec(next(text for _, text in BLOCKS if "xarray.DataArray(" in text), seen)
    records = seen["records"]
    rng = np.random.default_rng(0)
    records.values[:, 0, 5] = 1.0
    records.values[:] += 1e-3 * rng.standard_normal(records.shape)
    frf = updyn.estimate_frf(records, "3:-Z")
    assert (str(frf.references[0]), str(frf.responses[0])) == ("3:-Z", "7:Z")
    assert frf.quantity == "accelerance"


def test_every_kind_of_finding_is_in_the_table():
    source = "".join(
        path.read_text(encoding="utf-8") for path in Path(quality.__file__).parent.glob("*.py")
    )
    kinds = set(re.findall(r'RecordFinding\(\s*"([a-z-]+)"', source))
    table = PAGE.split("## Checks")[1]
    assert set(re.findall(r"(?m)^\| `([a-z-]+)` \| ", table)) - {"kind"} == kinds
