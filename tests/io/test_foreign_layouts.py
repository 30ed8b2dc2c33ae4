"""Twelve layouts of FRFs of other programs, each by the commands `new`, `check` and `run` alone.

The measurement is that of a chain of four masses whose springs differ from the model; numbers and names are synthetic.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from nptdms import ChannelObject, TdmsWriter

import testlab_samples as testlab
import uff_samples as uff
import updyn
from updyn.cli import main

#: Factors on the stiffness of the model's groups.
TRUTH = {"left": 1.2, "right": 0.85}
FREQ = np.linspace(2.0, 40.0, 39)
RESPONSES = ["1:Z", "2:Z", "4:Z"]
G = 9.80665


def chain(**factors: float) -> updyn.Model:
    """Return four masses of 1 kg in a row, held at both ends."""
    groups = {}
    for name, ends in (("left", ((None, 0), (0, 1))), ("right", ((1, 2), (2, 3), (3, None)))):
        K = np.zeros((4, 4))
        for pair in ends:
            held = [i for i in pair if i is not None]
            K[np.ix_(held, held)] += 2e4 * (2 * np.eye(len(held)) - 1) if len(held) == 2 else 2e4
        groups[name] = updyn.Group(factors.get(name, 1.0) * K, loss_factor=0.02)
    groups["masses"] = updyn.Group(mass=np.eye(4))
    return updyn.Model.from_groups(groups, [f"{node}:Z" for node in (1, 2, 3, 4)])


def measured() -> np.ndarray:
    """Return the accelerances of `RESPONSES` to 2:Z, with noise of 0.1 %."""
    H = updyn.response(
        chain(**TRUTH), FREQ, responses=RESPONSES, references=["2:Z"], quantity="accelerance"
    ).values[:, :, 0]
    rng = np.random.default_rng(11)
    return H * (1.0 + 1e-3 * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)))


H = measured()
DB, DEG = 20.0 * np.log10(np.abs(H)), np.angle(H, deg=True)


def rows(separator: str, *columns: Any, mark: str = ".") -> str:
    lines = [separator.join(c if isinstance(c, str) else repr(float(c)) for c in row) for row in zip(*columns, strict=True)]  # fmt: skip
    return "\n".join(lines).replace(".", mark) + "\n"


def toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value)


def options(**given: Any) -> list[str]:
    """Return reader options of the command line."""
    return [part for k, v in given.items() for part in ("--test-option", f"{k}={toml(v)}")]


def channels(*parts: dict[str, Any]) -> list[dict[str, Any]]:
    return [
        {"response": label, "reference": "2:Z", **part}
        for label, part in zip(RESPONSES, parts, strict=True)
    ]


ACCELERANCE = ["--quantity", "accelerance"]
LABELS = {"response_labels": RESPONSES, "reference_labels": ["2:Z"]}


# -- layouts: each writes its files, and returns the name of the measurement and the options of `new`
def labelled_names(folder: Path) -> tuple[str, list[str]]:
    """A table whose names hold labels and parts."""
    names = [f"{part} {label}/2:Z" for label in RESPONSES for part in ("Real", "Imag")]
    columns = [part for column in H.T for part in (column.real, column.imag)]
    text = "Frequency (Hz)," + ",".join(names) + "\n" + rows(",", FREQ, *columns)
    (folder / "a.csv").write_text("Analyser 4.2\nDate,2026-03-04\n\n" + text)
    return "a.csv", ACCELERANCE


def decimal_commas(folder: Path) -> tuple[str, list[str]]:
    """Decibels and degrees, with decimal commas and a line of units."""
    names = ";".join(f"Betrag {i};Phase {i}" for i in (1, 2, 3))
    columns = [part for i in range(3) for part in (DB[:, i], DEG[:, i])]
    text = f"Frequenz;{names}\nHz;{';'.join(['dB;°'] * 3)}\n"
    text += rows(";", FREQ, *columns, mark=",")
    (folder / "a.txt").write_text(text, encoding="cp1252")
    parts = [{"magnitude_dB": f"Betrag {i}", "phase_deg": f"Phase {i}"} for i in (1, 2, 3)]
    return "a.txt", ACCELERANCE + options(
        columns={"frequency": "Frequenz", "channels": channels(*parts)}
    )


def numbers_alone(folder: Path) -> tuple[str, list[str]]:
    """Columns without names, in g/N."""
    columns = [part / G for column in H.T for part in (column.real, column.imag)]
    (folder / "a.asc").write_text(rows("\t", FREQ, *columns))
    parts = [{"real": 2 + 2 * i, "imaginary": 3 + 2 * i} for i in range(3)]
    return "a.asc", options(columns={"frequency": 1, "unit": "g/N", "channels": channels(*parts)})


def complex_texts(folder: Path) -> tuple[str, list[str]]:
    """Complex numbers as MATLAB prints them, over the angular frequency."""
    texts = [[f"{z.real!r}{z.imag:+.17g}i" for z in column.tolist()] for column in H.T]
    text = "% omega [rad/s]\tH1\tH2\tH3\n" + rows("\t", 2.0 * np.pi * FREQ, *texts)
    (folder / "a.dat").write_text(text)
    parts = [{"complex": f"H{i}"} for i in (1, 2, 3)]
    columns = {"frequency": "omega [rad/s]", "channels": channels(*parts)}
    return "a.dat", ACCELERANCE + options(columns=columns)


def struct_of_pairs(folder: Path) -> tuple[str, list[str]]:
    """A struct with one field for each pair, as DataPhysics names them."""
    fields = {"f": FREQ, **{f"H1_{i + 2}": H[:, i] for i in range(3)}}
    scipy.io.savemat(folder / "a.mat", {"DPsv": fields})
    parts = [{"complex": f"DPsv.H1_{i + 2}"} for i in range(3)]
    return "a.mat", ACCELERANCE + options(
        variables={"freq": "DPsv.f", "channels": channels(*parts)}
    )


def tables_of_two_columns(folder: Path) -> tuple[str, list[str]]:
    """One complex array for each pair, with the frequency in its first column."""
    arrays = {f"point{i}": np.column_stack([FREQ, H[:, i]]) for i in range(3)}
    scipy.io.savemat(folder / "a.mat", arrays)
    parts = [{"complex": f"point{i}(:,2)"} for i in range(3)]
    variables = {"freq": "point0(:,1)", "channels": channels(*parts)}
    return "a.mat", ACCELERANCE + options(variables=variables)


def units_in_hdf5(folder: Path) -> tuple[str, list[str]]:
    """Datasets with attributes of units, responses along the first axis."""
    with h5py.File(folder / "a.h5", "w") as file:
        file["spectra/axis"] = FREQ / 1e3
        file["spectra/axis"].attrs["units"] = "kHz"
        file["spectra/frf"] = H.T / G
        file["spectra/frf"].attrs["units"] = "g/N"
    variables = {"freq": "spectra.axis", "H": "spectra.frf"}
    return "a.h5", options(variables=variables, order=["response", "freq"], **LABELS)


def magnitudes_in_npz(folder: Path) -> tuple[str, list[str]]:
    """Magnitude, phase in radians and coherence."""
    np.savez(folder / "a.npz", f=FREQ, mag=np.abs(H), ang=np.angle(H), coh=np.full(H.shape, 0.9999))
    variables = {"freq": "f", "magnitude": "mag", "phase_rad": "ang", "coherence": "coh"}
    return "a.npz", ACCELERANCE + options(variables=variables, **LABELS)


def one_file_per_point(folder: Path) -> tuple[str, list[str]]:
    """A file for each point, with its label in the name."""
    for label, column in zip(RESPONSES, H.T, strict=True):
        name = f"resp_{label.replace(':', '')}.txt"
        (folder / name).write_text("f re im\n" + rows(" ", FREQ, column.real, column.imag))
    one = {"response": "{node}:{axis}", "reference": "2:Z", "real": "re", "imaginary": "im"}
    given = options(columns={"frequency": "f", "channels": [one]})
    return "resp_{node}{axis}.txt", ACCELERANCE + given


def simcenter_testlab(folder: Path) -> tuple[str, list[str]]:
    """The MATLAB export of Simcenter Testlab."""
    points = [f"frame:{label.replace(':', ':+')}" for label in RESPONSES]
    axis = (FREQ[0], FREQ[1] - FREQ[0])
    testlab.save_5(
        folder / "a.mat", {"FRF": testlab.export(points, "frame:2:+Z", values=H, axis=axis)}
    )
    return "a.mat", []


def universal_file(folder: Path) -> tuple[str, list[str]]:
    """Functions of a universal file, in g and lbf."""
    raw = b""
    for label, column in zip(RESPONSES, H.T, strict=True):
        axes = {"types": (18, 12, 13), "units": ("Hz", "g", "lbf"), "x": FREQ}
        response = (int(label.split(":")[0]), 3)
        raw += uff.binary58(column / G * 4.4482216152605, response, (2, 3), **axes)
    (folder / "a.unv").write_bytes(raw)
    return "a.unv", []


def hits_in_tdms(folder: Path) -> tuple[str, list[str]]:
    """Time records of two hits, one in each group, from which `updyn frf` estimates FRFs."""
    seconds, n_samples = 1.0 / (FREQ[1] - FREQ[0]), 512
    pulse = np.zeros(n_samples)
    pulse[20:26] = np.sin(np.pi * np.arange(1, 7) / 7)
    force = np.fft.rfft(pulse)
    spectra = np.zeros((len(force), len(RESPONSES)), dtype=complex)
    at = np.round(FREQ * seconds).astype(int)
    spectra[at] = H * force[at, None]
    timing = {"wf_increment": seconds / n_samples, "wf_start_offset": 0.0}
    with TdmsWriter(folder / "hits.tdms") as writer:
        for group, level in (("hit 1", 1.0), ("hit 2", 1.5)):
            values = {"hammer": pulse, **dict(zip(RESPONSES, np.fft.irfft(spectra.T), strict=True))}
            for name, one in values.items():
                unit = "N" if name == "hammer" else "m/s^2"
                given = {**timing, "unit_string": unit}
                writer.write_segment([ChannelObject(group, name, level * one, given)])
    (folder / "records.toml").write_text(
        '[records]\nfile = "hits.tdms"\nreader = { group = ["hit 1", "hit 2"] }\n'
        f'excitation = {{ hammer = "2:Z" }}\nband = [{FREQ[0]}, {FREQ[-1]}]\noutput = "frf.uff"\n'
    )
    assert main(["frf", "records.toml"]) == 0
    return "frf.uff", []


LAYOUTS: list[Callable[[Path], tuple[str, list[str]]]] = [
    labelled_names,
    decimal_commas,
    numbers_alone,
    complex_texts,
    struct_of_pairs,
    tables_of_two_columns,
    units_in_hdf5,
    magnitudes_in_npz,
    one_file_per_point,
    simcenter_testlab,
    universal_file,
    hits_in_tdms,
]


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.__name__)
def test_a_layout_is_updated_by_commands_alone(layout, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    updyn.write_model(chain(), "model.npz")
    name, given = layout(tmp_path)
    assert main(["new", "model.npz", name, *given]) == 0, capsys.readouterr().err
    assert main(["check", "job.toml"]) == 0, capsys.readouterr().err
    code = main(["run", "job.toml"])
    out = capsys.readouterr()
    assert code == 0, out.out + out.err
    result = json.loads(Path("job/result.json").read_text(encoding="utf-8"))
    values = {one["name"]: one["value"] for one in result["parameters"]}
    for group, factor in TRUTH.items():
        assert values[f"{group}.stiffness"] == pytest.approx(factor, rel=2e-3)


def test_a_mapping_is_guessed_if_the_names_hold_all_labels(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    updyn.write_model(chain(), "model.npz")
    name, given = labelled_names(tmp_path)
    assert main(["new", "model.npz", name, *given]) == 0
    assert "columns: guessed from their names; check them" in capsys.readouterr().out
    text = Path("job.toml").read_text(encoding="utf-8")
    assert "# columns: guessed from their names; check them.\ncolumns = { frequency = " in text


def test_labels_on_the_command_line_complete_a_guess(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    updyn.write_model(chain(), "model.npz")
    name, given = labelled_names(tmp_path)
    text = (tmp_path / name).read_text()
    for number, label in enumerate(RESPONSES):
        text = text.replace(f"{label}/2:Z", f"point {'abc'[number]}")
    (tmp_path / "b.csv").write_text(text)
    assert main(["new", "model.npz", "b.csv", *given]) == 2
    assert 'response = "?", reference = "?", real = "Real point a"' in capsys.readouterr().err
    assert not (tmp_path / "job.toml").exists()
    np.savez(tmp_path / "c.npz", f=FREQ, frf=H)
    for file in ("b.csv", "c.npz"):
        job = f"job_{file[0]}.toml"
        assert main(["new", "model.npz", file, "--out", job, *given, *options(**LABELS)]) == 0
        assert main(["check", job]) == 0
    assert (
        main(
            ["new", "model.npz", "b.csv", *given, *options(**LABELS | {"response_labels": ["1:Z"]})]
        )
        == 2
    )
