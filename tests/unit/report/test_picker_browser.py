"""The page of modes in a browser: what a click picks, and FRFs that the page synthesises as Python does."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

import updyn
from programs import program
from updyn.correlation import frac
from updyn.modal import synthesise
from updyn.modal.synthesis import band_of_modes
from updyn.report.identified import write_modes_page

pytestmark = pytest.mark.needs("browser")

#: More lines than points of a curve, so that curves are thinned.
FREQ = np.linspace(0.0, 300.0, 5000)
NATURAL = np.array([31.0, 63.0, 118.0, 180.0, 232.0])
ETA = np.array([0.02, 0.012, 0.015, 0.01, 0.02])


def measured(quantity: str = "accelerance", decay: float = 0.0) -> updyn.FRF:
    """FRFs of five modes with a share and a floor of noise, and a disturbance at 150 Hz."""
    rng = np.random.default_rng(7)
    shapes, driven = rng.standard_normal((4, 5)), rng.standard_normal((5, 2))
    s = (2j * np.pi * FREQ + decay)[:, None]
    poles = (2 * np.pi * NATURAL) ** 2 * (1 + 1j * ETA)
    values = np.einsum("fr,ir,rj->fij", s**2 / (poles + s**2), shapes, driven)
    noise = rng.standard_normal((2, *values.shape, 2)) @ (1, 1j)
    values = values * (1 + 0.01 * noise[0]) + 0.02 * noise[1]
    values[2500] += 20.0 * rng.choice([-1, 1], (4, 2))
    power = {"receptance": 0, "accelerance": 2}[quantity]
    factor = np.where(np.abs(s) > 0, s, 1.0) ** (power - 2)
    labels = [f"{k}:Z" for k in range(1, 5)]
    return updyn.FRF(
        FREQ, values * factor[:, :, None], labels, ["1:Z", "8:Z"], quantity, decay=decay
    )


@pytest.fixture(scope="module")
def frf():
    return measured()


@pytest.fixture(scope="module")
def modes(frf):
    found = updyn.identify_modes(frf)
    near = np.abs(found.frequency[:, None] - NATURAL).min(axis=1) < 1.0
    assert near.sum() == 5
    assert found.unexplained == pytest.approx([FREQ[2500]])
    return found.select(near)


@pytest.fixture(scope="module")
def browser():
    sync_api = pytest.importorskip("playwright.sync_api")
    with sync_api.sync_playwright() as playwright:
        made = playwright.chromium.launch(executable_path=program("browser"), args=["--no-sandbox"])
        yield made
        made.close()


@pytest.fixture
def opened(browser, modes, frf, tmp_path):
    """A function that opens the page, and checks at the end that nothing went wrong in it."""
    pages = []

    def go(fragment="", shown=frf, width=1400, has_touch=False, **chosen):
        path = write_modes_page(chosen.pop("modes", modes), shown, tmp_path / "m.html", **chosen)
        page = browser.new_page(viewport={"width": width, "height": 1000}, has_touch=has_touch)
        page.set_default_timeout(60_000)
        page.goto(f"{path.as_uri()}{fragment}")
        page.wait_for_selector("#picker-plot .main-svg")
        pages.append(page)
        return page

    yield go
    for page in pages:
        assert page.evaluate("document.documentElement.dataset.errors ?? ''") == ""
        page.close()


def click(page, frequency, height=0.5, how=None):
    """Click in the diagram, at a share of its height from the top."""
    x, y = page.evaluate(
        """([frequency, height]) => {
          const place = document.getElementById("picker-plot"), { xaxis, yaxis } = place._fullLayout;
          const box = place.getBoundingClientRect();
          return [box.left + xaxis._offset + xaxis.d2p(frequency), box.top + yaxis._offset + height * yaxis._length];
        }""",
        [frequency, height],
    )
    (how or page.mouse.click)(x, y)


def picked(page):
    """The rows for the job: numbers by key."""
    rows = re.findall(r"(\w+) = \[(.*)\]", page.inner_text("#picks"))
    return {key: [float(f) for f in text.split(",")] for key, text in rows}


def marks(page, meta):
    return page.evaluate(
        "meta => document.getElementById('picker-plot').data.find((t) => t.meta === meta).x", meta
    )


def synthesised(page, frf):
    """What the page synthesises of all channels."""
    flat = page.evaluate(
        """() => {
          const { synthesis, entries } = updynPicks, fit = synthesis.fit(entries.filter((entry) => entry.on));
          return Array.from({ length: synthesis.channels }, (_, k) => [...synthesis.curve(fit, k)]);
        }"""
    )
    values = np.array(flat).reshape(-1, len(frf.freq), 2) @ (1, 1j)
    return values.T.reshape(frf.values.shape)


@pytest.mark.parametrize(("quantity", "decay"), [("accelerance", 0.0), ("receptance", 2.0)])
def test_the_page_synthesises_as_python_does(opened, modes, quantity, decay):
    shown = measured(quantity, decay)
    page = opened(shown=shown)
    expected = synthesise(modes, shown).values
    scale = np.abs(expected).max(axis=0)
    assert np.abs(synthesised(page, shown)[1:] - expected[1:]).max() < 1e-5 * scale.max()
    assert (np.abs(synthesised(page, shown)[1:] - expected[1:]) < 1e-4 * scale).all()


def test_a_mode_is_left_out_and_taken_again(opened, frf, modes):
    page = opened()
    assert marks(page, "mode") == pytest.approx(modes.frequency.tolist())
    click(page, modes.frequency[2])
    rest = modes.select([0, 1, 3, 4])
    assert picked(page) == {"pick": pytest.approx(rest.frequency.tolist(), rel=1e-6)}
    assert marks(page, "mode") == pytest.approx(rest.frequency.tolist())
    assert marks(page, "left-out") == pytest.approx([modes.frequency[2]])
    expected = synthesise(rest, frf).values
    assert np.abs(synthesised(page, frf) - expected).max() < 1e-5 * np.abs(expected).max()
    assert "4 modes; 1 left out." in page.inner_text("#picker-count")

    # FRAC of the same lines before and after
    inside = band_of_modes(modes, frf)
    before, after = (
        frac(frf.values[inside], synthesise(one, frf).values[inside]) for one in (modes, rest)
    )
    least = int(np.argmin(before))
    assert page.evaluate("document.getElementById('picker-channel').value") == str(least)
    said = page.inner_text("#picker-frac")
    one, middle, lowest = re.findall(r"([>\d.]+) → ([>\d.]+)", said)
    for text, figure in zip(one, (before.ravel()[least], after.ravel()[least]), strict=True):
        assert float(text.strip(">")) == pytest.approx(figure, abs=0.006)
    assert float(middle[1]) == pytest.approx(np.median(after), abs=0.006)
    assert float(lowest[1]) == pytest.approx(after.min(), abs=0.006)

    click(page, modes.frequency[2])
    assert picked(page) == {}
    assert "the modes are those that were found" in page.inner_text("#picks")

    # a frequency within its half-power band is that mode, too, and one beyond is not
    width = modes.frequency[2] * modes.loss_factor[2]
    for away, expected in ((0.4, {}), (0.6, {"pick", "poles"})):
        page.wait_for_timeout(500)  # two clicks in less are a double click
        click(page, modes.frequency[2])
        page.fill("#add-frequency", f"{modes.frequency[2] + away * width:.6g}")
        page.get_by_role("button", name="Add", exact=True).click()
        assert set(picked(page)) == set(expected)


def test_a_peak_and_any_other_frequency_are_added(opened, modes):
    page = opened()
    (peak,) = modes.unexplained
    assert marks(page, "peak") == pytest.approx([peak])
    click(page, peak)
    assert picked(page) == {"poles": pytest.approx([peak])}
    assert marks(page, "added") == pytest.approx([peak])
    assert marks(page, "peak") == []
    page.fill("#add-frequency", "13.54")
    page.get_by_role("button", name="Add", exact=True).click()
    assert picked(page) == {"poles": pytest.approx([13.54, peak])}
    click(page, 275.0)  # of a pixel, or the nearest maximum of the indicator
    (_, _, other) = picked(page)["poles"]
    assert other == pytest.approx(275.0, abs=2.0)
    assert "8 modes, 3 of them not refined yet." in page.inner_text("#picker-count")
    click(page, peak)
    assert picked(page) == {"poles": pytest.approx([13.54, other])}
    page.fill("#add-frequency", "301")
    page.get_by_role("button", name="Add", exact=True).click()
    assert "301 Hz is not within the band, 0 to 300 Hz." in page.inner_text("#picker-said")
    assert len(picked(page)["poles"]) == 2


def test_a_mode_that_is_missing_is_synthesised_once_it_is_added(opened, frf, modes):
    """With a loss factor that the page finds; from a frequency beside that of the mode."""
    some = dataclasses.replace(modes.select([0, 1, 3, 4]), unexplained=[])
    page = opened(modes=some)
    without = frac(frf.values, synthesise(some, frf).values).min()
    click(page, NATURAL[2])
    (f,) = picked(page)["poles"]
    assert f == pytest.approx(NATURAL[2], abs=0.7)
    loss = page.evaluate("updynPicks.entries.at(-1).loss")
    assert ETA[2] / 1.5 < loss < ETA[2] * 1.5
    assert frac(frf.values, synthesised(page, frf)).min() > max(0.9, without + 0.1)


def test_thinned_curves_keep_their_peaks(opened, frf):
    page = opened()
    at = int(page.evaluate("document.getElementById('picker-channel').value"))
    size = np.abs(frf.values.reshape(len(FREQ), -1)[:, at])
    drawn = page.evaluate(
        "() => { const t = document.getElementById('picker-plot').data.find((t) => t.meta === 'measured'); return [t.x, t.y]; }"
    )
    assert len(drawn[0]) <= 2000
    assert max(drawn[1]) == pytest.approx(size.max(), rel=1e-6)
    for f, y in zip(*drawn, strict=True):
        assert y == pytest.approx(size[np.argmin(np.abs(FREQ - f))], rel=1e-5)


def test_a_drag_zooms_all_panels_and_picks_nothing(opened, frf):
    page = opened()
    x = [
        page.evaluate(
            """(f) => { const place = document.getElementById("picker-plot"), { xaxis } = place._fullLayout;
              return place.getBoundingClientRect().left + xaxis._offset + xaxis.d2p(f); }""",
            f,
        )
        for f in (100.0, 130.0)
    ]
    y = page.locator("#picker-plot").bounding_box()["y"] + 200
    page.mouse.move(x[0], y)
    page.mouse.down()
    page.mouse.move(x[1], y, steps=5)
    page.mouse.up()
    page.get_by_text(re.compile(r"from (99|100)[\d.]* to 1(29|30|31)[\d.]* Hz")).wait_for()
    drawn = page.evaluate(
        "document.getElementById('picker-plot').data.find((t) => t.meta === 'measured').x"
    )
    inside = (drawn[0] <= FREQ) & (drawn[-1] >= FREQ)  # all of them: nothing is thinned
    assert list(drawn) == pytest.approx(FREQ[inside])
    assert drawn[0] == pytest.approx(100.0, abs=1.0)
    assert drawn[-1] == pytest.approx(130.0, abs=1.0)
    assert picked(page) == {}

    for _ in range(20):  # on a busy machine two clicks may be too far apart for a double one
        page.mouse.dblclick(x[0] + 20.0, y)  # back to all, and nothing is picked
        page.wait_for_timeout(500)
        if page.evaluate("document.getElementById('picker-plot')._fullLayout.xaxis.range[1] > 300"):
            break
    assert page.evaluate("document.getElementById('picker-plot')._fullLayout.xaxis.range[1] > 300")
    assert picked(page) == {}


def test_picks_of_the_address_are_shown(opened, modes):
    f = modes.frequency
    page = opened(f"#pick={f[0]:.7g},{f[3]:.7g}&poles=13.54")
    assert marks(page, "mode") == pytest.approx(f[[0, 3]])
    assert marks(page, "added") == [13.54]
    assert picked(page) == {"pick": pytest.approx(f[[0, 3]], rel=1e-6), "poles": [13.54]}


def test_a_mode_from_a_pole_keeps_the_frequency_that_was_picked(opened, modes):
    given = [None, None, 117.5, None, None]
    page = opened(poles=given)
    assert picked(page) == {"poles": [117.5]}
    click(page, modes.frequency[2])
    assert picked(page) == {}
    page = opened("#pick=&poles=117.5", poles=given)
    assert marks(page, "mode") == pytest.approx(modes.frequency.tolist())
    page = opened("#pick=&poles=", poles=given)
    assert marks(page, "left-out") == pytest.approx([modes.frequency[2]])


def test_the_last_mode_that_was_found_stays(opened, modes):
    page = opened(modes=modes.select([1]))
    click(page, modes.frequency[1])
    assert picked(page) == {}
    assert "At least one of the modes" in page.inner_text("#picker-said")


def test_pairs_of_modes_that_are_left_out_are_not_named(opened, modes):
    twice = dataclasses.replace(
        modes,
        frequency=modes.frequency * [1, 0, 1, 1, 1] + [0, modes.frequency[0] * 1.005, 0, 0, 0],
        shapes=modes.shapes[:, [0, 0, 2, 3, 4]],
    )
    page = opened(modes=twice)
    pair = page.get_by_text("They may be one mode found twice")
    assert pair.is_visible()
    page.get_by_role("button", name=f"{twice.frequency[1]:.5g} Hz").click()
    assert not pair.is_visible()


def test_the_page_fits_a_narrow_screen_and_hears_touches(opened, modes):
    page = opened(width=420, has_touch=True)
    assert page.evaluate("document.documentElement.scrollWidth") == 420
    assert page.evaluate("document.getElementById('picker-plot')._fullLayout._size.w") > 200
    click(page, modes.frequency[2], how=page.touchscreen.tap)
    page.get_by_text("4 modes; 1 left out.").wait_for()
