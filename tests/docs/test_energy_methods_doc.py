"""docs/methods.md, sections `force-residual` and `constitutive`: their table is computed here."""

from __future__ import annotations

import re
from statistics import median

import numpy as np
import pytest

import updyn
from pages import ROOT
from updyn.frf import FRF
from updyn.model import Model
from updyn.updating.fit.methods import METHODS, options_of

#: Biased methods leave a residual on purpose, whose causes other tests seek.
pytestmark = pytest.mark.usefixtures("no_causes")

TEXT = (ROOT / "docs" / "methods.md").read_text(encoding="utf-8")


def rows() -> dict[tuple[str, ...], list[str]]:
    (found,) = re.findall(r"^\| chain \|.*\n\|[-|]+\n((?:\|.*\n)+)", TEXT, re.MULTILINE)
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in found.splitlines()]
    return {tuple(re.findall(r"`([\w-]+)`", row[0])): row[1:] for row in cells}


@pytest.mark.parametrize("name", ["force-residual", "constitutive"])
def test_each_has_a_section_with_its_options_and_its_source(name: str) -> None:
    found = re.search(rf"^## `{name}`$(.*?)(?=^## |\Z)", TEXT, re.MULTILINE | re.DOTALL)
    assert found is not None
    for option in options_of(name):
        assert option in ("max_iterations", "tolerance") or f"`{option}" in found[1], option
    author = METHODS.find(name).reference.split(" ")[0].rstrip(",")
    assert author in TEXT


def test_the_figures(chain12: Model, chain12_true: Model, chain12_frf: FRF, add_noise) -> None:
    unknowns = updyn.parameters(chain12, stiffness="all", mass="all", loss_factor="all")
    everywhere = updyn.response(
        chain12_true,
        chain12_frf.freq[::2],
        [f"{i}:X" for i in range(1, 13)],
        ["2:X", "5:X", "12:X"],
    )

    def fitted(data: FRF, method: str, *solver: str) -> tuple[float, int]:
        options = {"solver": solver[0]} if solver else {}
        result = updyn.update(chain12, data, unknowns, method=method, **options)
        errors = []
        for p in unknowns:
            if p.is_factor:
                true, start = (
                    abs(getattr(m.group(p.group), p.quantity)).sum()
                    for m in (chain12_true, chain12)
                )
                errors.append(abs(result.values[p.name] - true / start))
        return max(errors), result.iterations

    table = rows()
    assert {method for method, *_ in table} == {
        "force-residual",
        "constitutive",
        "maximum-likelihood",
    }
    for method, (steps, *noisy) in table.items():
        error, taken = fitted(chain12_frf, *method)
        assert error < 1e-8, method
        # Without noise the last steps of maximum likelihood are those of rounding.
        near = 0.5 if method == ("maximum-likelihood",) else 0.05
        assert taken == pytest.approx(int(steps), rel=near, abs=1), method
        for said, clean in zip(noisy, (everywhere, chain12_frf), strict=True):
            draws = [
                fitted(add_noise(clean, np.random.default_rng(s), 0.01), *method)[0]
                for s in range(3)
            ]
            assert f"{float(f'{median(draws):.1g}'):g}" == said, method
    assert (
        f"{table['force-residual', 'trust-region'][0]} steps instead of"
        f" {table['force-residual',][0]} below" in TEXT
    )
