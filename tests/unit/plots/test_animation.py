"""Animated shapes: each frame is Re(u exp(i theta)) of the shape, files are equal, and what cannot be drawn is refused."""

from __future__ import annotations

import subprocess
import sys
from contextlib import nullcontext

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from PIL import Image

import updyn
from programs import program
from updyn.errors import DataError, FormatError, OptionError
from updyn.modal.shapes import make_shapes
from updyn.plots import animation
from updyn.plots.canvas import canvas
from updyn.report.picture import camera
from updyn.viewer.motion import amplitudes, check_moves, motion_of
from viewer_case import block, shaft

SIDE = (0.0, 0.0)  # seen along -X: Y to the right, Z up


def bar() -> updyn.Geometry:
    """Three nodes along Y, 2 m long."""
    return updyn.Geometry([1, 2, 3], [[0, 0, 0], [0, 1, 0], [0, 2, 0]], [[1, 2], [2, 3]])


def wave() -> updyn.ModeSet:
    """A wave that travels along the bar: each node lags by 90 degrees."""
    return updyn.ModeSet([12.0], [[2.0], [-2.0j], [2.0]], ["1:Z", "2:-Z", "3:Z"], [0.02])


def frames_of(shapes, turns, scale=0.1, view=SIDE):
    """The moving lines of each frame, shape (m, 2, 2), and the titles."""
    drawing = animation._Drawing(shapes, motion_of(shapes), camera(*view), scale)
    out = []
    with canvas(None, {"shape": 1.0}, (640, 480)) as made:
        for _ in drawing.draw(made, np.asarray(turns), 1):
            still, moving = (c for c in made.first.collections if isinstance(c, LineCollection))
            text = made.first.get_title(loc="left")
            out.append((np.array(moving.get_segments()), np.array(still.get_segments()), text))
    return out


def test_a_complex_mode_travels():
    """Heights by hand: a tenth of 2 m, cos(theta), -Re(-i exp(i theta)) = -sin(theta), cos(theta)."""
    for k, (lines, still, title) in enumerate(
        frames_of(make_shapes(wave(), bar()), np.arange(8) / 8)
    ):
        theta = 2 * np.pi * k / 8
        heights = 0.2 * np.array([np.cos(theta), -np.sin(theta), np.cos(theta)])
        expected = np.array([[0, heights[0]], [1, heights[1]], [2, heights[2]]])
        np.testing.assert_allclose(lines, expected[[[0, 1], [1, 2]]], atol=1e-12)
        np.testing.assert_allclose(still, [[[0, 0], [1, 0]], [[1, 0], [2, 0]]], atol=1e-12)
        assert title == (
            "Mode 1, 12 Hz, loss factor 0.02\ndisplacements × 0.1 (largest: 10 % of the diagonal)"
        )


def test_the_bar_fills_the_width_below_the_title():
    """It is 2 m long; the margins are 3 % of that."""
    shapes = make_shapes(wave(), bar())
    with canvas(None, {"shape": 1.0}, (640, 480)) as made:
        next(animation._Drawing(shapes, motion_of(shapes), camera(*SIDE), 0.1).draw(made, [0.0], 1))
        assert made.first.get_xlim() == pytest.approx((-0.06, 2.06))
        box = made.first.get_position()
        assert box.width > 0.95
        assert 0.8 < box.height < 0.95


def test_an_animation_without_options():
    given = animation.write_shapes.__kwdefaults__
    assert (given["scale"], given["frames"], given["fps"], given["periods"]) == (0.1, 24, 12, 1)


def test_amplitudes_are_those_of_the_ellipses():
    rng = np.random.default_rng(1)
    u = rng.standard_normal((5, 3)) + 1j * rng.standard_normal((5, 3))
    theta = np.linspace(0, 2 * np.pi, 20001)[:, None, None]
    lengths = np.linalg.norm((u * np.exp(1j * theta)).real, axis=2)
    np.testing.assert_allclose(amplitudes(u), lengths.max(axis=0), rtol=1e-6)


def test_an_operating_shape_is_that_of_the_nearest_line():
    values = np.array([[[1.0], [0.0], [0.0]], [[0.0], [0.5j], [0.0]]])
    frf = updyn.FRF([5.0, 7.0], values, ["1:Z", "2:Z", "3:Z"], ["1:Z"], "mobility", geometry=bar())
    ((lines, _, title),) = frames_of(make_shapes(frf, freq=6.8), [0.25])
    np.testing.assert_allclose(lines[:, :, 1], [[0, -0.2], [-0.2, 0]], atol=1e-12)
    assert title.startswith("Operating shape at 7 Hz, mobility to 1:Z\ndisplacements × 0.4")


def test_discs_of_a_drive_train_turn():
    """Rims move by half their radius at most, whatever the scale of the mode."""
    model = shaft()
    shapes = make_shapes(updyn.modes(model, 3), model, select=[1])
    (lines, _, title), *_ = frames_of(shapes, [0.0], view=(0.0, 90.0))
    motion = motion_of(shapes)
    rim = motion.body.xyz[motion.body.real :]
    moved = lines[-1][-1] - (rim @ camera(0.0, 90.0)[:2].T)[-4]  # the end of the last spoke
    assert np.linalg.norm(moved) == pytest.approx(0.5 * motion.body.disc)
    assert title.splitlines()[1].startswith("rotations × ")


def test_a_model_is_drawn_whole_and_sensors_alone():
    model = block()
    computed = updyn.modes(model, 2)
    assert motion_of(make_shapes(computed, model)).body.name == "model"
    measured = updyn.ModeSet([1.0], [[1.0], [0.5]], ["2:Z", "3:Z"])
    motion = motion_of(make_shapes(measured, model))
    assert motion.body.nodes.tolist() == [2, 3]
    np.testing.assert_array_equal(motion.shapes[0], [[0, 0, 1.0], [0, 0, 0.5]])


def test_gif(tmp_path):
    paths = [tmp_path / name for name in ("a.gif", "b.gif")]
    modes = updyn.ModeSet(
        [12.0, 20.0], np.array([[1.0, 1], [1j, -1], [0, 1j]]), ["1:Z", "2:Z", "3:Z"]
    )
    for path in paths:
        updyn.write_shapes(modes, path, bar(), frames=3, fps=10, view=SIDE)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    with Image.open(paths[0]) as image:
        assert (image.n_frames, image.size, image.info["duration"]) == (6, (640, 480), 100)
    assert sorted(tmp_path.iterdir()) == paths


@pytest.mark.needs("ffmpeg")
def test_mp4(tmp_path):
    paths = [tmp_path / name for name in ("a.mp4", "b.mp4")]
    for path in paths:
        updyn.write_shapes(wave(), path, bar(), frames=4)
    assert paths[0].read_bytes() == paths[1].read_bytes()
    found = subprocess.run(
        [program("ffmpeg"), "-i", paths[0], "-f", "null", "-"], capture_output=True, text=True
    )
    assert "640x480" in found.stderr
    assert "12 fps" in found.stderr
    assert "yuv420p" in found.stderr


def test_without_ffmpeg_the_program_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(animation.shutil, "which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(OptionError, match=r"ffmpeg.*updyn\[video\].*a GIF"):
        updyn.write_shapes(wave(), tmp_path / "a.mp4", bar())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"view": 3}, "view: expected azimuth and elevation"),
        ({"view": ("a", "b")}, "view: expected azimuth and elevation"),
        ({"scale": 0.0}, "scale: expected a number above 0"),
        ({"fps": 0.5}, "fps: expected a whole number of at least 1"),
        ({"frames": 2}, "frames: expected a whole number of at least 3"),
        ({"periods": 1.5}, "periods: expected a whole number"),
        ({"period": 1}, "did you mean 'periods'"),
    ],
)
def test_options_are_checked(tmp_path, more, message):
    with pytest.raises(OptionError, match=message):
        updyn.write_shapes(wave(), tmp_path / "a.gif", bar(), **more)
    assert not list(tmp_path.iterdir())


def test_a_suffix_that_is_not_of_the_format(tmp_path):
    with pytest.raises(FormatError, match=r"the suffix \.gif or \.mp4"):
        updyn.write_shapes(wave(), tmp_path / "a.png", bar(), format="animation")


@pytest.mark.parametrize(("moved", "is_drawn"), [(1e-12, False), (1.9e-7, False), (2.1e-7, True)])
def test_shapes_without_translations_are_refused(moved, is_drawn):
    """Torsion of a bar of 2 m, whose nodes lie on its axis to rounding."""
    values = np.array([[moved, 1.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.0]])
    torsion = updyn.ModeSet([12.0, 30.0], values, ["1:Z", "1:RY", "3:Z", "3:RY"])
    shapes = make_shapes(torsion, bar())
    with (
        nullcontext()
        if is_drawn
        else pytest.raises(DataError, match=r"Mode 1, 12 Hz: has no translations.* by select")
    ):
        check_moves(shapes, motion_of(shapes))
    kept = make_shapes(torsion, bar(), select=[1])
    check_moves(kept, motion_of(kept))
