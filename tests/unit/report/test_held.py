"""What was held, on the page: selection and regularisation, as the options of the result have them."""

from __future__ import annotations

import numpy as np
import pytest

import updyn
from updyn.report.page import render
from updyn.report.regularisation import trade_off


@pytest.fixture(scope="module")
def chain():
    groups = {}
    for i in range(4):
        K, M = np.zeros((4, 4)), np.zeros((4, 4))
        K[i, i], M[i, i] = 1e5, 1.0
        if i:
            K[i - 1, i - 1], K[i, i - 1], K[i - 1, i] = 1e5, -1e5, -1e5
        groups[f"s{i + 1}"] = updyn.Group(K, M, 0.02)
    return updyn.Model.from_groups(groups, [f"{i + 1}:X" for i in range(4)])


@pytest.fixture(scope="module")
def frf(chain):
    return updyn.response(
        chain.scaled({"s2": {"stiffness": 1.05}}), np.linspace(5.0, 90.0, 25), ["4:X"], ["4:X"]
    )


def fit(chain, frf, unknowns, **options):
    return updyn.update(chain, frf, unknowns, starts=0, **options)


@pytest.mark.parametrize("how", ["gcv", "l-curve", "tsvd:3", 2.0])
def test_a_regularised_fit_shows_how_and_its_curve(chain, frf, how):
    result = fit(chain, frf, updyn.parameters(chain, stiffness="all"), regularise=how)
    html, figure = render(result), trade_off(result)
    assert '<section id="held">' in html
    assert 'data-figure="trade-off"' in html
    record = result.options["regularisation"]
    (x,), (y,) = figure["data"][1]["x"], figure["data"][1]["y"]
    assert (x, y) == (record["misfit here"], record["distance here"])
    shown = np.array(figure["data"][0]["y"], dtype=float)
    assert (np.diff(shown) >= 0).all() if record["how"] == "tsvd" else (np.diff(shown) <= 0).all()
    assert shown.max() > 1.05 * shown.min()
    said = (
        "3 of 4 directions were fitted"
        if how == "tsvd:3"
        else "pulled to their start as by one of standard deviation"
    )
    assert said in html


def test_a_selection_shows_what_was_joined_and_left_out_and_why(chain, frf):
    unknowns = updyn.parameters(chain, stiffness="all")
    chosen = updyn.select(chain, frf, updyn.cluster(chain, frf, unknowns, 0.5), 2)
    html = render(fit(chain, frf, chosen))
    assert '<section id="held">' in html
    assert "Regularisation</h3>" not in html
    for name, why in chosen.left_out.items():
        assert name in html
        assert why in html
    assert all(name in html for name in chosen.merged)


def test_a_free_fit_has_no_such_section(chain, frf):
    assert 'id="held"' not in render(fit(chain, frf, updyn.parameters(chain, stiffness="all")))


def test_the_page_of_several_tests_has_it_once(chain, frf):
    tests = [updyn.Test(chain, frf, name) for name in ("one", "two")]
    unknowns = updyn.parameters(chain, stiffness="all")
    joint = updyn.update_jointly(tests, unknowns, regularise="gcv", starts=0)
    assert render(joint).count('<section id="held">') == 1
    assert "#held" not in render(updyn.update_jointly(tests, unknowns, starts=0))
