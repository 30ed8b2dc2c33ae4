"""What follows in a run if model and test have hardly a mode in common: `ModeComparison`."""

import json
import warnings

import pytest

import updyn
from turned_chain import TURNED, measured, model
from updyn.errors import UpdynWarning
from updyn.store.result import result_to_json
from updyn.updating.judge.counterparts import Counterparts


def unknowns(of):
    return updyn.parameters(of, stiffness=["a", "b"], loss_factor=["a", "b"])


@pytest.fixture(scope="module")
def alien():
    with pytest.warns(UpdynWarning, match=r"of \d measured modes ha.*Compare model and test first"):
        return updyn.update(model(), measured(TURNED), unknowns(model()))


def test_the_search_ends_after_its_first_tries(alien):
    assert alien.counterparts.few
    tries = sum(step.stage == "search" and step.step == 0 for step in alien.history)
    assert 3 <= tries <= 6  # three tries, on few and on all lines
    assert len(alien.history) < 500


def test_its_answer_is_not_called_usable(alien):
    assert alien.status != "converged"
    assert alien.trust["resembles"] == False  # noqa: E712
    assert alien.badge.phrase == "Does not resemble the test"
    assert alien.counterparts.statement in alien.message
    assert alien.counterparts.statement == alien.trust["resembles"].why
    assert "The search ended after its first tries" in alien.message
    assert alien.remedy.startswith("Compare model and test first")


def test_the_record_has_it(alien, tmp_path):
    updyn.write_result(alien, tmp_path / "run.nc")
    assert updyn.read_result(tmp_path / "run.nc").counterparts == alien.counterparts
    record = json.loads(json.dumps(result_to_json(alien)))["counterparts"]
    assert record["n_measured"] == alien.counterparts.n_measured
    assert record["known"] is True


def test_a_model_that_is_off_is_searched_and_updated():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = updyn.update(model((1.4, 0.7)), measured(), unknowns(model()))
    found = result.counterparts
    assert isinstance(found, Counterparts)
    assert found.n_paired == found.n_measured >= 5
    assert result.status == "converged"
    assert result.trust["resembles"].holds is True
    assert result.values["a.stiffness"] == pytest.approx(1 / 1.4, rel=0.01)
    assert "first tries" not in result.message
