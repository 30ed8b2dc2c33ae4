"""Numbers that decide outcomes of single-module rooms: rounding, positions, progress, notebooks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RoundingSettings:
    """Differences that are due to rounding."""

    #: [1] Relative difference up to which matrix entries, eigenvalues and frequencies of a table
    #: are equal. Why: matrices of other programs are computed in double precision, with sums of
    #: many terms, and often written with 10 digits or more.
    relative: float = 1e-10
    #: [1] Share of the largest value of an FRF below which a value is rounding. Rounding: where
    #: symmetry makes an FRF zero, the computed values are below it.
    receptance_share: float = 1e-11
    #: [1] Excess of a coherence above 1 that is accepted as 1. Why: two units in the last place of
    #: single precision, in which analysers compute it.
    coherence_excess: float = 2.0**-22
    #: [1] Relative difference up to which a stated RMS is that of a spectrum. Why: files in text
    #: state six digits or more.
    rms_difference: float = 1e-5


@dataclass(frozen=True)
class ModelCheckSettings:
    """Checks of the matrices of a model."""

    #: [DOFs] Largest matrix whose eigenvalues are checked; of larger ones, only the diagonal and
    #: the 2 x 2 minors. Effort: the time of a dense eigensolver is a fraction of a second.
    dense_dofs: int = 600


@dataclass(frozen=True)
class VariantSettings:
    """Variants of a model without a mistake in its definition."""

    #: [DOFs] Largest model whose variants are compared with data. Effort: a variant takes about a
    #: second.
    largest_model: int = 5_000


@dataclass(frozen=True)
class PositionSettings:
    """Comparison of the positions of nodes with equal numbers in test and model."""

    #: [1] Distance above which a pair is gross, as a share of the model's size. Why: the fifth mode
    #: of a beam has a wavelength of about 0.4 of its length, so a sensor is an eighth of a
    #: wavelength away.
    gross_share: float = 0.05
    #: [1] Largest distance to the nearest node that is not gross, as a share of the model's size.
    #: Why: in a coarse model the nearest node may be a quarter of the size away.
    coarse_share: float = 0.25
    #: [1] Default tolerance of a match by position, as a share of the model's size. Why: accuracy
    #: of measurements by hand; a rule of thumb.
    matched_share: float = 0.01
    #: [1] Rms distance of pairs in another unit, as a share of the rms radius of the nodes, up to
    #: which the unit is accepted. Why: units differ by a factor of 2.5 or more (cm and in).
    unit_share: float = 0.2
    #: [1] The same after a rigid motion. Why: it has six more unknowns to bring pairs together.
    rigid_share: float = 0.1
    #: [1] Rms distance over that of the given pairs, below which another system is accepted. Why: a
    #: rule of thumb; a right system reduces the distances by far more.
    better_share: float = 0.25
    #: [1] Width of a set of points over its length, up to which they are in a line. Why: a
    #: unit of the sixth digit, with which positions are given.
    line_width: float = 1e-6
    #: [deg] Rotation of the test from which its directions may be along other axes. Why: rounding
    #: of the positions turns a structure by less.
    least_rotation: float = 1.0


@dataclass(frozen=True)
class MessageSettings:
    """Length of messages."""

    #: [items] Largest number of items that a message lists, such as pairs of nodes or equations.
    #: Drawing: a rule of thumb; a message is read at a glance.
    listed_items: int = 6


@dataclass(frozen=True)
class NotebookSettings:
    """Pictures and tables of objects in notebooks."""

    #: [channels] Largest number of channels that are drawn as curves, and of labels that are
    #: listed; of more, the rms is drawn. Drawing: more curves cannot be told apart by colour.
    most_channels: int = 8
    #: [bins] Bins of a curve, each drawn with its minimum and maximum. Drawing: about the width of
    #: a picture in px.
    curve_bins: int = 600
    #: [rows] Largest number of rows of a table. Drawing: a table is shown without scrolling.
    most_rows: int = 20
    #: [lines] Largest number of lines of a drawn structure. Drawing: each takes about 50 bytes of
    #: the notebook file.
    structure_lines: int = 3000
    #: [nodes] Largest number of nodes of a model that can be rotated. Drawing: a notebook stores
    #: the data of each output.
    viewer_nodes: int = 20_000


@dataclass(frozen=True)
class FigureSettings:
    """Figures of reports, of matplotlib and of the viewer."""

    #: [cells] Largest map whose values are printed in its cells. Drawing: in more cells, the
    #: numbers overlap.
    printed_cells: int = 150
    #: [curves] Largest number of curves that a legend names. Drawing: more curves cannot be told
    #: apart by colour and dash.
    legend_entries: int = 12
    #: [lines] Largest number of measured lines that are drawn as points; more are drawn as a curve.
    #: Drawing: more points overlap.
    measured_points: int = 200
    #: [channels] Largest number of channels of an overlay. Drawing: each is a panel of the figure.
    overlay_channels: int = 16
    #: [nodes] Largest number of nodes of a group without lines that is drawn as squares. Drawing:
    #: lumped masses have few nodes; a larger group would hide the structure.
    lumped_nodes: int = 4
    #: [1] Largest displacement of a shape over the product of its largest rotation and the size of
    #: the structure, up to which it has no translations to draw. Drawing: rounding of eigenvectors
    #: is smaller, and the displacement of a beam that bends is not.
    still_share: float = 1e-7
    #: [nodes] Largest number of other nodes among which those next to a sensor are searched.
    #: Drawing: the neighbours of a node of an even grid are among its nearest 6 (8 in a plane with
    #: diagonals), and twice as many leave room for uneven ones.
    neighbours: int = 16
    #: [1] Smallest distance between two ticks of a colour scale over its length. Drawing: the scale
    #: of the viewer is seven lines of text high.
    tick_distance: float = 0.14


@dataclass(frozen=True)
class ProgressSettings:
    """Display of progress."""

    #: [s] Shortest time between a plain line and the first of another stage. Drawing: a run of
    #: seconds is not described stage by stage.
    stage_interval: float = 1.0
    #: [s] Shortest time between plain lines of a stage. Drawing: a log of minutes has ten lines.
    line_interval: float = 10.0
    #: [1] Shortest time between plain lines of a stage as a share of the elapsed time. Drawing: the
    #: number of lines grows with the logarithm of the run time.
    line_growth: float = 0.5
    #: [s] Longest time between plain lines. Drawing: a run of hours still shows that it lives.
    longest_interval: float = 600.0
    #: [s] Run time of a stage from which its remaining time is estimated. Drawing: the first lines
    #: include the start of workers.
    estimate_delay: float = 1.0
    #: [s] Shortest time between two updates of a bar in a notebook. Drawing: each is a message to
    #: the browser.
    bar_interval: float = 0.2


ROUNDING = RoundingSettings()
MODEL_CHECK = ModelCheckSettings()
VARIANTS = VariantSettings()
POSITIONS = PositionSettings()
MESSAGES = MessageSettings()
NOTEBOOK = NotebookSettings()
FIGURES = FigureSettings()
PROGRESS = ProgressSettings()
