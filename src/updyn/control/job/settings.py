"""Numbers that decide how the control part of a job compares and simulates."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlantComparisonSettings:
    """Numbers of the comparison of a plant with its model, and of its uncertainty weights."""

    #: [lines] Lines over the band, with even spacing and with even ratios, in addition to those
    #: around modes. Why: a rule of thumb; modes have separate lines.
    spread_lines: int = 300
    #: [modes] Largest number of modes with lines around them. Effort: 13 lines for each.
    most_modes: int = 80
    #: [half widths] Distances of lines from each mode, on both sides, in units of half its
    #: half-power width. Why: a rule of thumb.
    line_offsets: tuple[float, ...] = (0.2, 0.5, 1.0, 1.5, 3.0, 6.0)
    #: [DOFs] Number of DOFs above which the response of the model is computed with a reduced model.
    #: Effort: each line needs a factorisation of the full model.
    reduced_dofs: int = 20_000
    #: [1] Certified relative error of that reduced model. Rounding: small relative to the tolerance
    #: of a plant, 0.02.
    reduced_accuracy: float = 1e-6
    #: [1] Share of its peak below which a channel is 0 in relative errors. Rounding: rounding of
    #: the response.
    uncoupled_share: float = 1e-10
    #: [channels] Largest number of channels with a weight, without a servo that selects them.
    #: Effort: each weight is a search over orders.
    most_weights: int = 9


@dataclass(frozen=True)
class CycleSimulationSettings:
    """Numbers of the simulation of a nonlinearity if the job states no duration."""

    #: [periods] Simulated periods of the predicted limit cycle. Why: a rule of thumb; the last 40 %
    #: are classified.
    cycle_periods: int = 40
    #: [periods] Simulated periods of the bandwidth if no cycle is predicted. Why: a rule of thumb.
    settling_periods: int = 6
    #: [1] Initial amplitude as a multiple of that of the cycle. Why: a rule of thumb; the
    #: simulation then shows that it converges.
    start_factor: float = 1.2
    #: [steps] Largest number of steps. Effort: a rule of thumb.
    most_steps: int = 300_000


@dataclass(frozen=True)
class TuningSettings:
    """Sliders of the controller in the window."""

    #: [decades] Range of a slider to both sides of the number in the job. Drawing: an arrow key
    #: then moves it visibly; after writing, the sliders are in the middle again.
    decades: float = 1.0
    #: [decades] Step of a slider. Drawing: 5 percent for an arrow key.
    step: float = 0.02
    #: [s] Rest after which the loop is computed. Effort: not for each step of a drag.
    pause: float = 0.15


PLANT_COMPARISON = PlantComparisonSettings()
CYCLE_SIMULATION = CycleSimulationSettings()
TUNING = TuningSettings()
