"""Which engine is meant."""

from __future__ import annotations

import pytest

from updyn.engines import Engine, Serial, choose_engine
from updyn.errors import OptionError


def test_none_is_this_process():
    engine = choose_engine(None)
    assert isinstance(engine, Serial)
    assert (engine.workers, engine.name) == (1, "serial")


def test_an_engine_is_itself():
    engine = Serial()
    assert isinstance(engine, Engine)
    assert choose_engine(engine) is engine


@pytest.mark.parametrize("given", ["two", 2.0, Serial, [], True])
def test_anything_else_is_refused_by_name(given):
    with pytest.raises(OptionError, match=r"^engine is .* \((str|float|type|list|bool)\); expected None.* or an engine$"):
        choose_engine(given)
