"""The page about the window names all its pages, and what it says of limits is what holds."""

from __future__ import annotations

import re

import pytest

from pages import ROOT
from updyn.web.settings import WEB_LIMIT

pytest.importorskip("nicegui")

TEXT = (ROOT / "docs" / "app.md").read_text(encoding="utf-8")


def test_every_page_is_described():
    from updyn.web.pages import PAGES
    from updyn.web.steps import STEPS

    described = re.findall(r"^\| ([A-Z][\w ]+?) \| ", TEXT, re.MULTILINE)
    assert described == [*STEPS.values(), *(name for name, _ in PAGES.values())]


def test_limits():
    assert f"at most {WEB_LIMIT.upload_bytes // 2**20} MB" in TEXT
