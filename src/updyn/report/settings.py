"""Numbers that decide how much a report computes, draws and lists."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ReportComputationSettings:
    """Lines at which a report computes the models."""

    #: [1] Share of the measured level, and of the residual, from which noise is most of a channel.
    #: Why: beyond a half, a perfect model would not change what the channel shows.
    noise_share: float = 0.5
    #: [lines x DOFs] Largest number at which the models are computed at every measured line.
    #: Effort: seconds to a few minutes.
    evaluation_budget: int = 2_000_000
    #: [lines x DOFs] The same after the user has stopped the run. Effort: about a second.
    stopped_budget: int = 50_000
    #: [lines] Largest number of measured lines. Effort: more than a figure has pixels.
    most_lines: int = 5_000
    #: [lines] Smallest number of measured lines, also for large models. Effort: fewer do not show
    #: the curves.
    least_lines: int = 100
    #: [lines] Smallest number of measured lines after a stop. Effort: the user waits.
    least_stopped_lines: int = 8
    #: [lines] Additional lines for the curves of the models, evenly spaced. Effort: about half the
    #: pixels of a figure.
    even_lines: int = 400
    #: [lines] Largest number of additional lines near resonances. Effort: 75 resonances with 16
    #: lines each.
    resonance_lines: int = 1_200
    #: [lines x DOFs] Largest number for all additional lines. Effort: a quarter of the time of the
    #: measured lines.
    grid_budget: int = 500_000
    #: [lines] Lines of the band of uncertainty. Effort: each is computed for every draw.
    band_lines: int = 400
    #: [draws] Draws from which the band is computed. Effort: five of them lie beyond each end of a
    #: band of 95 %; a rule of thumb.
    band_draws: int = 200
    #: [1] Lines x DOFs x solves of the band, as a multiple of the budget of the models, above which
    #: the page has no band. Effort: some minutes.
    band_cost: int = 20
    #: [lines] Lines of the curves on a page of comparison. Effort: about the pixels of a figure.
    comparison_lines: int = 600
    #: [1] Change of an equivalent stiffness by an undetermined parameter, over the stiffness, from
    #: which it has no band. Drawing: less is not visible.
    visible_share: float = 1e-3
    #: [1] Loss of an element over its stiffness up to which it is elastic. Rounding: far above
    #: rounding of a sum over samples.
    elastic_share: float = 1e-9
    #: [lines] Measured lines on a page of comparison up to which points are drawn. Effort: a curve
    #: would suggest data between the lines.
    comparison_points: int = 150


@dataclass(frozen=True)
class ReportSizeSettings:
    """Size of a page in the browser."""

    #: [bytes] Largest size of the FRFs on a page, before base64. Drawing: 100 channels of 2,000
    #: lines with coherence are complete in a page of less than 10 MB.
    frf_bytes: int = 4_000_000
    #: [1] Share of it for the measured data. Drawing: they have coherence in addition to the
    #: values; the models have more lines.
    measured_share: float = 0.62
    #: [lines] Smallest number of lines of a channel. Drawing: fewer do not show a curve.
    least_channel_lines: int = 50
    #: [lines] Largest number of lines of a curve of selected channels. Drawing: more than a figure
    #: has pixels.
    curve_lines: int = 3_000
    #: [lines] Largest number of lines of a curve on the first screen. Drawing: about two for each
    #: pixel of its width.
    small_curve_lines: int = 600
    #: [lines] Largest number of measured points of one force level. Drawing: more would hide the
    #: curves.
    level_points: int = 200
    #: [points] Points of an equivalent stiffness over amplitude. Drawing: about a pixel each.
    amplitude_points: int = 200
    #: [1] Ratio of the ends of this amplitude to the largest motions in the tests. Drawing: a
    #: margin.
    amplitude_margin: float = 3.0
    #: [lines] Lines of an FDAC map. Drawing: about three pixels each.
    fdac_lines: int = 120
    #: [numbers] Largest number of displacements of modes. Drawing: 1.6 MB.
    mode_displacements: int = 600_000
    #: [modes] Smallest number of modes with shapes. Drawing: the lowest modes are shown also of
    #: large models.
    least_modes: int = 4
    #: [numbers] Largest number of values of operating shapes. Drawing: a third of the size of the
    #: mode shapes.
    operating_values: int = 200_000
    #: [lines] Smallest number of lines with operating shapes. Drawing: fewer would miss resonances.
    least_operating_lines: int = 40
    #: [references] Largest number of forces with operating shapes. Drawing: a limit of size; tests
    #: have fewer.
    operating_references: int = 8
    #: [lines] Largest number of drawn lines of a structure. Drawing: the time of the browser for a
    #: picture.
    structure_lines: int = 8_000
    #: [lines] Largest number of drawn lines of a geometry in a COMAC map. Drawing: half of those of
    #: a larger picture.
    map_lines: int = 4_000


@dataclass(frozen=True)
class ReportListSettings:
    """How many items lists, tables and figures show."""

    #: [unknowns] Unknowns in the figure of changes; those with the largest change are kept.
    #: Drawing: the figure fits on a printed page.
    changed_unknowns: int = 40
    #: [1] Smallest distance between the ticks of a figure of changes in half the width of a page,
    #: as a fraction of its axis. Drawing: more labels would overlap.
    tick_gap: float = 0.2
    #: [unknowns] Unknowns with the largest changes on the first screen. Drawing: they fit next to
    #: the verdict at 800 px of height.
    largest_changes: int = 5
    #: [elements] Nonlinear elements whose stiffness is drawn. Drawing: two figures each.
    shown_elements: int = 8
    #: [tests] Tests whose worst channel is on the first screen. Drawing: two figures are side by
    #: side on it.
    shown_tests: int = 2
    #: [unknowns] Unknowns in the map of sensitivities; those with the largest are kept. Drawing:
    #: the map fits on the first screen.
    sensitive_unknowns: int = 10
    #: [modes] Modes of that map up to which each has its frequency and cells have numbers. Drawing:
    #: more would overlap in half the width of a screen.
    sensitivity_ticks: int = 12
    #: [1] Least MAC of a pair of modes that is drawn as good. Why: the least
    #: cross-orthogonality of correlated models in NASA-STD-5002.
    high_mac: float = 0.9
    #: [1] Least MAC of a pair that is drawn as fair. Why: a common limit below which shapes are
    #: regarded as different.
    fair_mac: float = 0.7
    #: [channels] Channels in the map of misfits; those with the largest misfit are kept. Drawing:
    #: the map fits on a printed page.
    misfit_channels: int = 60
    #: [sensors] Sensors in the COMAC figure; those with the lowest COMAC are kept. Drawing: more
    #: labels would overlap.
    comac_sensors: int = 100
    #: [nodes] Nodes in a COMAC map up to which they have their number. Drawing: more labels would
    #: overlap.
    labelled_nodes: int = 40
    #: [channels] Channels that an axis names. Drawing: more labels would overlap.
    named_channels: int = 24
    #: [rows] Rows of the table of modes that are shown unfolded. Drawing: a screen.
    unfolded_rows: int = 20
    #: [terms] Terms of a combination of unknowns that are written. Drawing: a few lines of text.
    written_terms: int = 16
    #: [entries] Entries of a list of options that are written. Drawing: a few lines of text.
    written_entries: int = 20
    #: [pairs] Pairs of similar modes that are listed. Drawing: a short list; the number of the
    #: others follows.
    listed_pairs: int = 8
    #: [curves] Singular values of the CMIF that are drawn. Drawing: more lie in the noise.
    indicator_curves: int = 4
    #: [channels] Smallest number of channels for an FDAC map. Why: with one or two channels, shapes
    #: of different lines are alike.
    fdac_channels: int = 3
    #: [1] Smallest FDAC of a matching pair of lines. Why: a common limit of MAC for the same mode.
    fdac_ridge: float = 0.8
    #: [1] Relative difference of parameter values that is invisible in the figures of convergence.
    #: Why: less than a pixel.
    invisible_change: float = 1e-3
    #: [1] Relative difference between the frequencies of one mode from two computations. Why: the
    #: accuracy of iterative eigensolvers; modes closer than this are combined.
    same_frequency: float = 1e-6


REPORT_COMPUTATION = ReportComputationSettings()
REPORT_SIZE = ReportSizeSettings()
REPORT_LIST = ReportListSettings()
