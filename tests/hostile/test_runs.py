"""A run as a process that is stopped, finds its disk full, or its folder in use; a few of `make torture`."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals and limits are those of POSIX")


@pytest.mark.parametrize("kind", ["SIGTERM", "full disks", "two at once"])
def test_the_folder_holds_the_old_results_or_the_new_ones(kind: str, tmp_path: Path) -> None:
    import torture_runs

    (one,) = (one for one in torture_runs.tortures() if one.kind == kind)
    outcome = one.trial(0, tmp_path)
    assert not outcome.failed, outcome.detail
