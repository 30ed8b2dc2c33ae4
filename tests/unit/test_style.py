"""Design tokens: the palette survives colour blindness and grey print, maps are even, pages and figures use them."""

from __future__ import annotations

import re
from itertools import combinations, pairwise

import numpy as np
import pytest

from places import ROOT
from updyn import style
from updyn.frf import FRF
from updyn.report.scene import _TEST

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


@pytest.mark.parametrize("sight", SEEN)
@pytest.mark.parametrize("ground", [style.PAPER, style.DARK])
def test_the_test_has_no_colour_of_a_group(ground, sight):
    """Test and sensors of the viewer lie over groups in the colours of the scales."""
    own, _ = _TEST
    names = [f"{side}-{step}" for side in ("less", "more") for step in range(1, 5)]
    for name in [*names, *(f"seq-{step}" for step in range(8)), "same", "none"]:
        assert np.linalg.norm(lab(ground[own], sight) - lab(ground[name], sight)) >= 15.0, name


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


# -- measured, start and updated: one colour each, in figures, report, window, viewer and pictures
STATES = {name: style.PAPER[role] for name, role in style.STATES.items()}
LINES = np.linspace(1.0, 5.0, 40)


def frf(factor: float = 1.0) -> FRF:
    values = factor / (9.0 - LINES**2 + 0.1j * LINES)
    return FRF(LINES, values[:, None, None], ["1:X"], ["1:X"], "receptance")


def test_the_three_are_told_apart_by_everyone():
    """CIELAB distance as seen without L or M cones, lightness in grey print, contrast by WCAG 2.2."""
    for ground in (style.PAPER, style.DARK):
        colours = [ground[role] for role in style.STATES.values()]
        for sight in SEEN:
            for i in range(3):
                apart = [lab(colours[i], sight) - lab(colours[j], sight) for j in range(i)]
                assert all(np.linalg.norm(each) >= 15.0 for each in apart)
        assert all(contrast(colour, ground["ground"]) >= 3.0 for colour in colours)
    grey = sorted(lab(colour)[0] for colour in STATES.values())
    assert np.diff(grey).min() >= 11.0


def test_start_is_orange_and_updated_is_blue():
    """Lab hue angle: about 55 degrees is orange, about 265 blue; measured is grey."""
    hue = {
        name: np.degrees(np.arctan2(*lab(colour)[:0:-1])) % 360 for name, colour in STATES.items()
    }
    assert 40 < hue["start"] < 80
    assert 230 < hue["updated"] < 290
    assert np.hypot(*lab(STATES["measured"])[1:]) < 10


def test_other_curves_have_none_of_the_three():
    others = {style.state(name, number) for number, name in enumerate(("computed", "a", "b"))}
    assert others == set(style.OTHERS)
    assert not others & set(style.STATES.values())


# -- figures of matplotlib
def test_figures():
    pytest.importorskip("matplotlib")
    from updyn import plots

    for computed, labels in (
        ([frf(1.1), frf(1.2)], None),
        ([frf(1.1)], ["start"]),
        ([frf(1.1)], ["updated"]),
        ([frf(1.1)] * 3, ["updated", "other", "start"]),
    ):
        axes = plots.overlay(frf(), *computed, labels=labels).axes[0]
        shown = {line.get_label(): line.get_color() for line in axes.lines}
        for name, colour in shown.items():
            assert colour == STATES.get(name, style.PAPER["third"]), name
        assert {*shown} >= {"measured", *(labels or ("start", "updated"))}


def test_the_picture_of_the_manual():
    pytest.importorskip("matplotlib")
    text = (ROOT / "docs" / "pictures" / "chain.svg").read_text(encoding="utf-8")
    found = set(re.findall(r"(?:stroke|fill): (#[0-9a-f]{6})", text))
    assert found - {"#ffffff", "#000000"} == set(STATES.values())
    # the script that draws it has no colour of its own
    script = (ROOT / "tools" / "make_pictures.py").read_text(encoding="utf-8")
    assert not re.findall(r"#[0-9a-fA-F]{6}|color=\"", script)


# -- report
def test_the_report():
    from updyn.report import comparison, scene, unknowns
    from updyn.report.plots import MODEL_COLOURS

    assert {name: f"@{style.STATES[name]}" for name in ("start", "updated")} == MODEL_COLOURS
    assert scene._LOOKS["updated"][0] == style.STATES["updated"]
    assert scene._START_LOOKS["start"][0] == scene._LOOKS["start"][0] == style.STATES["start"]
    assert scene._LOOKS["test"] == scene._START_LOOKS["test"] == scene._TEST
    assert unknowns._start_trace(np.ones(2))["marker"]["color"] == MODEL_COLOURS["start"]
    assert comparison.OTHERS is style.OTHERS


def test_the_scripts_of_the_report():
    """Their words are the names of the three, their keys and classes the roles."""
    assets = ROOT / "src" / "updyn" / "report" / "assets"
    script = (assets / "overlay.js").read_text(encoding="utf-8")
    words = re.search(r"const words = \{(.+)\}", script)
    assert words is not None
    named = dict(re.findall(r'(\w+): "(\w+)"', words[1]))
    assert {name: role for role, name in named.items()} == style.STATES
    for role in named:
        assert f'{role}: {{ color: "@{role}"' in script
        rule = f"i.line.{role} {{ background: var(--{role}); }}"
        assert rule in (assets / "report.css").read_text(encoding="utf-8")


# -- viewer and window
def test_the_viewer():
    from updyn.viewer import scene

    assert set(style.STATES.values()) < set(scene.ROLES)


def test_the_window():
    pytest.importorskip("nicegui")
    from updyn.web.charts import frf_chart
    from updyn.web.look import HEAD

    curve = (LINES, frf().values[:, 0, 0])
    for names in (("measured", "start"), ("measured", "updated", "start"), ("measured", "updated")):
        chart = frf_chart("receptance", dict.fromkeys(names, curve))
        for trace in chart["data"]:
            assert trace["line"]["color"] == f"@{style.STATES[trace['name']]}"
    for colour in STATES.values():
        assert colour in HEAD


# -- no other place
def test_no_other_module_states_a_colour():
    """But for the child process of the still picture of a model, and grounds of dialogs."""
    allowed = {"style.py"}
    found = []
    for folder in (ROOT / "src" / "updyn", ROOT / "tools", ROOT / "docs" / "site"):
        for path in folder.rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if path.name not in allowed and re.search(
                r"[\"']#[0-9a-fA-F]{6}[\"']|[\"']C[0-9][\"']|tab:", text
            ):
                found.append(path.relative_to(ROOT).as_posix())
    assert found == []
