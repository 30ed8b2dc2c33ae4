"""Mode shapes and operating shapes in motion, as GIF or MP4.

A complex shape u moves as Re(u exp(i theta)), so that phases between nodes are visible as waves.
The view is orthographic. Equal shapes give equal files.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from updyn.arrays import ComplexArray, IndexArray, RealArray
from updyn.errors import FormatError, OptionError
from updyn.group import is_number
from updyn.io.atomic import atomic_path
from updyn.modal.shapes import Shapes
from updyn.plots.canvas import Canvas, canvas
from updyn.report.picture import VIEWS, camera
from updyn.style import PAPER
from updyn.viewer.motion import Motion, check_moves, motion_of

if TYPE_CHECKING:
    from matplotlib.animation import AbstractMovieWriter

__all__ = ["find_ffmpeg", "write_shapes"]

#: [px] Width and height. Why: a common size of small videos; H.264 requires even numbers.
_SIZE = (640, 480)
#: [1] Largest motion of the rim of a disc, as a share of its radius. Why: the rim moves along its
#: tangents, which enlarges the disc by 12 % at most.
_TURN = 0.5
#: [1] Margin on each side, as a share of the drawn range. Why: dots at the edge are drawn whole.
_MARGIN = 0.03
_MOVING, _STILL = PAPER["after"], PAPER["measured"]


def write_shapes(
    shapes: Shapes,
    path: str | Path,
    *,
    view: Sequence[float] = VIEWS["front"],
    scale: float = 0.1,
    frames: int = 24,
    fps: int = 12,
    periods: int = 1,
) -> None:
    """Write shapes one after the other; the suffix selects GIF or MP4.

    `view` is azimuth and elevation in degrees. The largest displacement is drawn as the share
    `scale` of the diagonal of the structure. A period of a shape has `frames` frames, `fps` of them
    in a second, and is shown `periods` times.
    """
    make_writer = _WRITERS.get(Path(path).suffix.lower())
    if make_writer is None:
        raise FormatError(f"animations have the suffix {' or '.join(_WRITERS)}", path)
    _check(view, scale, frames, fps, periods)
    motion = motion_of(shapes)
    check_moves(shapes, motion)
    drawing = _Drawing(shapes, motion, camera(*view), scale)
    with canvas(None, {"shape": 1.0}, _SIZE) as made, atomic_path(path) as temporary:
        writer = make_writer(fps)
        with writer.saving(made.figure, str(temporary), dpi=made.figure.dpi):
            for _ in drawing.draw(made, np.arange(frames) / frames, periods):
                writer.grab_frame()


def _check(view: Any, scale: Any, frames: Any, fps: Any, periods: Any) -> None:
    if np.shape(view) != (2,) or not all(is_number(x) and np.isfinite(x) for x in view):
        raise OptionError(
            f"view: expected azimuth and elevation in degrees, such as (38, 24), found {view!r}",
            key=("view",),
        )
    if not (isinstance(scale, int | float) and 0 < scale < np.inf):
        raise OptionError(f"scale: expected a number above 0, found {scale!r}", key=("scale",))
    for name, value, least in (("frames", frames, 3), ("fps", fps, 1), ("periods", periods, 1)):
        if not (isinstance(value, int | np.integer) and value >= least):
            raise OptionError(
                f"{name}: expected a whole number of at least {least}, found {value!r}",
                key=(name,),
            )


# -- writers ---------------------------------------------------------------------------------------
def _make_gif_writer(fps: int) -> AbstractMovieWriter:
    from matplotlib.animation import PillowWriter

    return PillowWriter(fps=fps)


def _make_mp4_writer(fps: int) -> AbstractMovieWriter:
    import matplotlib
    from matplotlib.animation import FFMpegWriter

    matplotlib.rcParams["animation.ffmpeg_path"] = find_ffmpeg()  # in the context of the canvas
    # Without bitexact, the file has the version of the encoder; threads divide frames.
    exact = ["-threads", "1", "-fflags", "+bitexact", "-flags:v", "+bitexact"]
    return FFMpegWriter(fps=fps, codec="h264", extra_args=["-pix_fmt", "yuv420p", *exact])


def find_ffmpeg() -> str:
    """Return the path of ffmpeg: the program of the system, or of the package imageio-ffmpeg."""
    found = shutil.which("ffmpeg")
    if found is not None:
        return found
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError as error:
        raise OptionError(
            'MP4 needs the program ffmpeg: install it, or pip install "updyn[video]"; a GIF (.gif)'
            " needs neither"
        ) from error
    return str(get_ffmpeg_exe())


_WRITERS: Mapping[str, Callable[[int], AbstractMovieWriter]] = {
    ".gif": _make_gif_writer,
    ".mp4": _make_mp4_writer,
}


# -- drawing ---------------------------------------------------------------------------------------
@dataclass(frozen=True, slots=True, eq=False)
class _Drawing:
    """Shapes of a structure, seen along the third row of `eye`, shape (3, 3)."""

    shapes: Shapes
    motion: Motion
    eye: RealArray
    scale: float

    @property
    def loose(self) -> IndexArray:
        """Nodes that are drawn as points: sensors, lumped parts, nodes without lines and faces."""
        body = self.motion.body
        if body.name == "test":
            return np.arange(body.real)
        drawn = np.zeros(len(body.nodes), dtype=np.bool_)
        drawn[body.lines.ravel()] = True
        drawn[body.faces.ravel()] = True
        drawn[body.points] = False
        return np.flatnonzero(~drawn)

    @property
    def still_lines(self) -> RealArray:
        """Lines of the structure at rest, shape (m, 2, 3)."""
        body = self.motion.body
        if body.name == "model":
            return np.asarray(body.xyz[body.lines])
        geometry = self.shapes.geometry
        return np.asarray(geometry.xyz[geometry.line_ends])

    def draw(self, made: Canvas, turns: RealArray, periods: int) -> Iterator[None]:
        """Draw the frames of all shapes at `turns` of a period, from 0 to 1; yield after each."""
        from matplotlib.collections import LineCollection, PolyCollection

        body, axes = self.motion.body, made.first
        flat = self.eye[:2].T
        axes.set_axis_off()
        axes.add_collection(
            LineCollection(list(self.still_lines @ flat), colors=_STILL, linewidths=0.7)
        )
        faces = PolyCollection([], facecolors=PAPER["plain"], edgecolors="none", alpha=0.35)
        lines = LineCollection([], colors=_MOVING, linewidths=1.2)
        axes.add_collection(faces)
        axes.add_collection(lines)
        (dots,) = axes.plot([], [], color=_MOVING, linestyle="none", marker="o", markersize=4)
        loose = self.loose
        sized = [self._scale(number) for number in range(len(self.shapes))]
        axes.set_title("\n")
        made.figure.draw_without_rendering()
        made.figure.set_layout_engine("none")  # the same for every frame
        self._set_limits(made, [u for u, _ in sized])
        for (u, text), title in zip(sized, self.shapes.titles(), strict=True):
            axes.set_title(f"{title}\n{text}")
            for turn in np.tile(turns, periods).tolist():
                xyz = body.xyz + (u * np.exp(2j * np.pi * turn)).real
                xy = xyz @ flat
                lines.set_segments(list(xy[body.lines]))
                depth = (xyz @ self.eye[2])[body.faces].mean(axis=1)
                faces.set_verts(list(xy[body.faces[np.argsort(depth, kind="stable")]]))
                dots.set_data(*xy[loose].T)
                yield

    def _scale(self, number: int) -> tuple[ComplexArray, str]:
        """Return the drawn displacements of a shape, shape (n, 3), and the scale in words."""
        body = self.motion.body
        u = self.motion.shapes[number].copy()
        moved, turned = self.motion.largest(number)
        texts = []
        if moved:
            size = float(np.linalg.norm(np.ptp(body.xyz, axis=0))) or 1.0
            u[: body.real] *= self.scale * size / moved
            texts.append(
                f"displacements × {self.scale * size / moved:.3g}"
                f" (largest: {100 * self.scale:g} % of the diagonal)"
            )
        if turned:
            u[body.real :] *= _TURN * body.disc / turned
            texts.append(f"rotations × {_TURN * body.disc / turned:.3g}")
        return u, "; ".join(texts)

    def _set_limits(self, made: Canvas, drawn: Sequence[ComplexArray]) -> None:
        """Set limits that contain every frame, in the ratio of the sides of the axes."""
        flat = self.eye[:2].T
        corners = [self.still_lines.reshape(-1, 3) @ flat]
        xy = self.motion.body.xyz @ flat
        for u in drawn:
            reach = np.abs(u @ flat)
            corners += [xy - reach, xy + reach]
        every = np.concatenate(corners)
        low, high = every.min(axis=0), every.max(axis=0)
        box = made.first.get_position()
        sides = np.array([box.width, box.height]) * made.figure.get_size_inches()
        half = (0.5 + _MARGIN) * (float(((high - low) / sides).max()) or 1.0) * sides
        middle = 0.5 * (low + high)
        made.first.set_xlim(middle[0] - half[0], middle[0] + half[0])
        made.first.set_ylim(middle[1] - half[1], middle[1] + half[1])
        made.first.set_aspect("equal")  # last, as it would shrink the axes to other limits
