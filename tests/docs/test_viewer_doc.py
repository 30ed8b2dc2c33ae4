"""The example of docs/viewer.md runs, and makes what it says."""

from __future__ import annotations

import re
from typing import Any

from places import ROOT

PAGE = (ROOT / "docs" / "viewer.md").read_text(encoding="utf-8")


def test_the_example_runs() -> None:
    found = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    made: dict[str, Any] = {}
    exec(found[1], made)
    body = made["scene"].bodies[0]
    assert len(body.faces) == 2
    assert len(made["scene"].modes.rows) == 4
    assert made["frame"].startswith("<iframe")
    assert made["page"].startswith("<!DOCTYPE html>")
