"""Every malformed model, and FRF in .npz or .mat: one of our errors, with the file's name and the expected words.

The files are written by ``tests/data/bad/make_bad_model.py``.
"""

import json
from pathlib import Path

import pytest

import updyn
from places import DATA

BAD = DATA / "bad"
MODELS = json.loads((BAD / "model" / "expected.json").read_text())
FRFS = json.loads((BAD / "frf_npz_mat" / "expected.json").read_text())


def test_there_are_enough_and_none_is_left_out():
    assert len(MODELS) >= 50
    assert len(FRFS) >= 15
    for folder, expected in (("model", MODELS), ("frf_npz_mat", FRFS)):
        matrices = {
            Path(name).with_suffix(".mtx").name for name in expected if name.endswith(".toml")
        }
        files = {p.name for p in (BAD / folder).iterdir()} - {"expected.json"}
        assert files - matrices - {"alone.mtx", "not_a_matrix.mtx"} == {
            n for n in expected if not n.endswith(".mtx")
        }


@pytest.mark.parametrize("name", MODELS)
def test_model_is_refused(name):
    with pytest.raises(updyn.UpdynError) as caught:
        updyn.read_model(BAD / "model" / name)
    assert MODELS[name] in str(caught.value)
    assert Path(name).stem in str(caught.value)


@pytest.mark.parametrize("name", FRFS)
def test_frf_is_refused(name):
    with pytest.raises(updyn.UpdynError) as caught:
        updyn.read_frf(BAD / "frf_npz_mat" / name)
    assert FRFS[name] in str(caught.value)
    assert name in str(caught.value)


@pytest.mark.parametrize("name", [n for n in MODELS if not n.endswith((".toml", ".mtx"))])
def test_every_beginning_of_a_binary_file_is_refused(name, tmp_path):
    """A transfer that broke off: no length of the file may be taken for a whole one, or raise anything else."""
    raw = (BAD / "model" / name).read_bytes()
    path = tmp_path / name
    for part in (0.02, 0.1, 0.3, 0.5, 0.8, 0.97):
        path.write_bytes(raw[: int(len(raw) * part)])
        with pytest.raises(updyn.UpdynError) as caught:
            updyn.read_model(path)
        assert name in str(caught.value)
