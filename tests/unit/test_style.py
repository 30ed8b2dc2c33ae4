"""Design tokens: the palette survives colour blindness and grey print, maps are even, pages and figures use them."""

from __future__ import annotations

import re
from itertools import combinations, pairwise

import numpy as np
import pytest

from places import ROOT
from updyn import style

ASSETS = ROOT / "src" / "updyn" / "report" / "assets"

#: Linear RGB as seen without L cones (protanopia) and without M cones (deuteranopia); Machado, Oliveira & Fernandes
#: 2009, table 1, severity 1.
SEEN = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
}
#: sRGB to XYZ under D65 (IEC 61966-2-1).
TO_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.072175],
        [0.0193339, 0.119192, 0.9503041],
    ]
)


def linear(colour: str) -> np.ndarray:
    c = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def lab(colour: str, sight: str = "normal") -> np.ndarray:
    """CIELAB (CIE 15:2004) of a colour as seen with some sight."""
    t = TO_XYZ @ np.clip(SEEN[sight] @ linear(colour), 0.0, 1.0) / (TO_XYZ @ np.ones(3))
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def contrast(one: str, other: str) -> float:
    """Ratio of WCAG 2.2."""
    low, high = sorted(float((TO_XYZ @ linear(c))[1]) for c in (one, other))
    return (high + 0.05) / (low + 0.05)


def test_the_formulas_give_known_values():
    np.testing.assert_allclose(lab("#ffffff"), [100, 0, 0], atol=1e-6)
    np.testing.assert_allclose(lab("#0000ff"), [32.297, 79.188, -107.860], atol=5e-3)  # Lindbloom
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    for sight in SEEN:  # whoever looks, grey is grey
        np.testing.assert_allclose(lab("#808080", sight)[1:], 0.0, atol=0.05)


@pytest.mark.parametrize("sight", SEEN)
@pytest.mark.parametrize("ground", [style.PAPER, style.DARK])
def test_curves_keep_apart_for_everyone(ground, sight):
    roles = ("measured", *style.CATEGORIES)
    for one, other in combinations(roles, 2):
        apart = np.linalg.norm(lab(ground[one], sight) - lab(ground[other], sight))
        assert apart >= 15.0, (one, other)


def test_categories_keep_apart_in_grey_print():
    grey = sorted(lab(style.PAPER[role])[0] for role in style.CATEGORIES)
    assert min(b - a for a, b in pairwise(grey)) >= 11.0
    for role in ("before", "after"):  # with what was measured in one figure
        assert abs(lab(style.PAPER[role])[0] - lab(style.PAPER["measured"])[0]) >= 11.0


@pytest.mark.parametrize("ground", [style.PAPER, style.DARK])
def test_curves_and_text_stand_out_from_the_ground(ground):
    for role in ("measured", *style.CATEGORIES):
        assert contrast(ground[role], ground["ground"]) >= 3.0, role
    for role in ("text", "muted", "link", "good", "warn", "bad"):
        assert contrast(ground[role], ground["ground"]) >= 4.5, role
    for role in ("good", "warn", "bad"):
        assert contrast(ground[role], ground[f"{role}-ground"]) >= 4.5, role


def test_the_steps_of_sizes_are_those_of_the_sequential_map():
    """On paper; both grounds are even in lightness."""
    stops = np.array([[int(c[i : i + 2], 16) for i in (1, 3, 5)] for c in style.SEQUENTIAL])
    at = np.arange(1, 9) / 8.0
    places = np.linspace(0.0, 1.0, len(stops))
    expected = np.column_stack([np.interp(at, places, channel) for channel in stops.T])
    names = [f"seq-{step}" for step in range(8)]
    found = [[int(style.PAPER[n][i : i + 2], 16) for i in (1, 3, 5)] for n in names]
    np.testing.assert_allclose(found, expected, atol=0.51)
    for colours in (style.PAPER, style.DARK):
        steps = np.diff([lab(colours[name])[0] for name in names])
        assert (np.sign(steps) == np.sign(steps[0])).all()
        assert abs(steps).min() > 4.0  # told apart in grey print


def test_the_sequential_map_is_even_in_lightness():
    steps = np.diff([lab(stop)[0] for stop in style.SEQUENTIAL])
    assert (steps < 0).all()
    assert steps.min() / steps.max() < 1.2
    assert steps.sum() < -70.0


def test_the_diverging_map_is_even_and_the_same_both_ways():
    level = np.array([lab(stop)[0] for stop in style.DIVERGING])
    np.testing.assert_allclose(level, level[::-1], atol=2.0)
    steps = np.abs(np.diff(level))
    assert steps.max() / steps.min() < 1.25
    for sight in SEEN:
        for low, high in ((0, 4), (1, 3)):
            ends = lab(style.DIVERGING[low], sight) - lab(style.DIVERGING[high], sight)
            assert np.linalg.norm(ends) >= 40.0


def test_categories_go_on_with_other_dashes():
    looks = [style.category(i) for i in range(16)]
    assert len(set(looks)) == 16
    assert looks[0] == (style.PAPER["after"], "-")
    assert looks[4] == (style.PAPER["after"], "--")


def test_a_scale_has_its_stops_from_0_to_1():
    scale = style.colour_scale(style.DIVERGING)
    assert [at for at, _ in scale] == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert tuple(colour for _, colour in scale) == style.DIVERGING


# -- one place -------------------------------------------------------------------------------------
def test_sheets_state_no_colour_and_know_their_variables():
    viewer = ROOT / "viewer" / "src" / "viewer.css"
    for path in (ASSETS / "report.css", ASSETS / "structure.css", viewer):
        sheet = path.read_text(encoding="utf-8")
        assert re.findall(r"#[0-9a-fA-F]{3,8}\b|rgba?\(", sheet) == []
        declared = set(re.findall(r"--([\w-]+):", style.css() + sheet))
        used = set(re.findall(r"var\(--([\w-]+)\)", sheet))
        assert used <= declared


@pytest.mark.parametrize(("ground", "way"), [(style.PAPER, -1), (style.DARK, 1)])
@pytest.mark.parametrize("kind", ["less", "more"])
def test_the_larger_a_change_the_more_its_colour_stands_out(ground, way, kind):
    steps = np.diff([lab(ground[f"{kind}-{size}"])[0] for size in (1, 2, 3, 4)])
    assert (way * steps >= 6.0).all()


@pytest.mark.parametrize("sight", SEEN)
@pytest.mark.parametrize("ground", [style.PAPER, style.DARK])
def test_softer_and_stiffer_keep_apart_for_everyone(ground, sight):
    for size in (1, 2, 3, 4):
        apart = lab(ground[f"less-{size}"], sight) - lab(ground[f"more-{size}"], sight)
        assert np.linalg.norm(apart) >= 20.0, size


def test_figures_of_the_report_know_their_colours():
    named = set()
    for path in (ROOT / "src" / "updyn").rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if "updyn.report" in text:
            named |= set(re.findall(r'"@([a-z-]+)"', text))
    assert {"before", "after", "muted"} <= named <= set(style.PAPER)


def test_the_variables_have_the_values_of_the_tokens():
    text = style.css()
    light, dark = text.split("@media screen")[0], text.split("@media screen")[1].split("@media")[0]
    for name, value in style.PAPER.items():
        assert f"--{name}: {value};" in light
    for name, value in style.DARK.items():
        assert f"--{name}: {value};" in dark
    assert "--size-title: 1.9rem;" in light
    assert set(style.DARK) == set(style.PAPER)
    assert set(style.PRINTED) <= set(style.PAPER)
