"""Fits without a search for the causes of their residual, which takes seconds each."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from updyn.updating.judge.causes.of_run import Causes, CauseSearch


@contextmanager
def no_cause_search() -> Iterator[None]:
    """Let fits end without findings: for tests of something else with a residual on purpose."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(CauseSearch, "detect_data_fault", lambda self, monitor: False)
        patch.setattr(CauseSearch, "search_after_fit", lambda self, found, monitor: Causes())
        yield
