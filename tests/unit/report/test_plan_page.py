"""The page of a plan, by value."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import updyn
from report_case import chain
from updyn.report import write_plan


@pytest.fixture(scope="module")
def plan():
    model = chain(4)
    line = updyn.Geometry([1, 2, 3, 4], np.eye(3)[[0, 0, 0, 0]] * [[1], [2], [3], [4]], [(1, 4)])
    model = updyn.Model.from_groups(model.groups, model.dofs, geometry=line)
    unknowns = updyn.parameters(model, stiffness="all")
    return updyn.plan(model, unknowns, "all", 2, 1, (10.0, 300.0), robust=0)


@pytest.mark.parametrize(("std", "shown"), [(0.0, "0 %"), (np.inf, "∞ %")])
def test_what_is_known_exactly_or_not_at_all_has_a_colour(plan, tmp_path, std, shown):
    """Its logarithm is not finite."""
    odd = replace(plan, std=dict(plan.std) | {"bay 2.stiffness": std})
    page = write_plan(odd, tmp_path / "plan.html").read_text(encoding="utf-8")
    (found,) = re.findall(r'<li><i class="s-(\d)"></i>bay 2: stiffness ±([^<]*)</li>', page)
    assert found == ("4" if std else "1", shown)
