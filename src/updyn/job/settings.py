"""Numbers that decide what a new job proposes and which modes a job picks."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ModePickSettings:
    """Numbers of the frequencies that a job picks."""

    #: [1] Largest relative difference between a picked frequency and the mode or peak nearest to
    #: it. Why: for frequencies written by hand, read from a plot.
    mode_distance: float = 0.02
    #: [1] Largest relative difference between a picked frequency and a stable pole that was
    #: clicked. Why: a click gives the frequency to seven digits.
    clicked_distance: float = 2e-6
    #: [bandwidths] Least distance between a clicked pole and a mode. Why: a nearer pole is that of
    #: the mode; a rule of thumb.
    separate_distance: float = 0.25


@dataclass(frozen=True)
class ProposalSettings:
    """Numbers of a proposed job file."""

    #: [sensors] Largest number of sensors listed in a comment. Drawing: chosen for a readable file.
    listed_sensors: int = 24
    #: [responses] Least number of responses for which one is held out. Why: with fewer, the fit
    #: needs all; a rule of thumb.
    hold_out_from: int = 4
    #: [lines] From this number of lines on, only the most informative ones are proposed. Why:
    #: limits the time of a fit.
    many_lines: int = 200
    #: [lines] Number of lines proposed. Why: limits the time of a fit; a rule of thumb.
    chosen_lines: int = 100
    #: [1] Proposed bounds of the factors of stiffness. Why: a rule of thumb.
    stiffness_bounds: tuple[float, float] = (0.2, 5.0)
    #: [1] Proposed bounds of the factors of mass. Why: masses are mostly known better than
    #: stiffnesses; a rule of thumb.
    mass_bounds: tuple[float, float] = (0.5, 2.0)
    #: [1] Proposed bounds of the factors of viscous damping. Why: damping is known by order of
    #: magnitude only.
    viscous_bounds: tuple[float, float] = (0.01, 100.0)
    #: [1] Proposed upper bound of a loss factor. Why: above that of metal structures with joints.
    largest_loss_factor: float = 0.3
    #: [1] Proposed start of a loss factor if the model is undamped. Why: a fit cannot start at 0; a
    #: rule of thumb.
    start_loss_factor: float = 0.01


@dataclass(frozen=True)
class JobMessageSettings:
    """Numbers of messages about job files."""

    #: [characters] Longest value that a message repeats. Drawing: chosen for one line of text.
    longest_value: int = 40


MODE_PICK = ModePickSettings()
PROPOSAL = ProposalSettings()
JOB_MESSAGE = JobMessageSettings()
