"""Numbers that decide which faults of records are found."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ClippingSettings:
    """Numbers of the search for overloads."""

    #: [samples] Number of samples at the largest value that indicates an overload. Why: two equal
    #: neighbours occur at a regular peak.
    least_samples: int = 3
    #: [steps] Least jump onto these samples, in steps of the converter. Why: a slow signal also
    #: stays at its peak for several samples.
    least_jump: float = 5.0
    #: [steps] Size of the largest value, in steps of the converter, above which equal samples need
    #: not be consecutive. Why: equal values are then not chance; 14 bits, a rule of thumb.
    fine_value: float = 2.0**14
    #: [steps] Least jump, in steps of the converter, for two consecutive samples. Why: the
    #: probability of a pair of equal values at a regular peak is one step over the jump, here 1e-4.
    pair_jump: float = 1e4
    #: [steps] The jumps on either side of a pair differ by more than this number of steps. Why:
    #: those of a computed symmetric pulse are equal.
    uneven_steps: float = 10.0
    #: [1] The jumps on either side of a pair differ by more than this share. Why: rounding of a
    #: computed symmetric pulse.
    uneven_share: float = 1e-6
    #: [steps] Least value, in steps of the converter and per pair of hits, of equal largest values
    #: in two hits. Why: for smaller values, equality is chance among hits whose levels differ by 1
    #: %.
    repeated_value: float = 1e5


@dataclass(frozen=True)
class HitForceSettings:
    """Numbers of the check of the force of a hit."""

    #: [1] Least force of a second hit, as a share of the largest. Why: smaller ones cause ripples
    #: of less than 5 % in the spectrum.
    second_share: float = 0.05
    #: [1] Least force of a second hit, as a multiple of the median of the noise. Why: noise does
    #: not reach it.
    second_over_noise: float = 20.0
    #: [1] A hit ends when its force stays below this share of the largest for as long as it rose.
    #: Why: a rule of thumb.
    end_share: float = 0.02
    #: [dB] Level of the force, relative to its largest line, below which it is noise. Why: a rule
    #: of thumb.
    least_level: float = -20.0


@dataclass(frozen=True)
class HitResponseSettings:
    """Numbers of the check of the responses to a hit."""

    #: [1] Least level of the end of a truncated response, and of a response before the hit, as a
    #: share of its level after the hit. Why: leakage of about 2 %; a rule of thumb.
    least_share: float = 0.02
    #: [1] Number of parts of a record; the level is that of the first and of the last. Why: a part
    #: contains many samples and little decay.
    parts: int = 20
    #: [samples] Least number of samples before the hit that determine an offset or a level. Why: a
    #: level from 16 samples is known to 20 %.
    rest_samples: int = 16
    #: [samples] Samples before the hit that are excluded. Why: the filters of converters ring
    #: there.
    filter_samples: int = 64
    #: [1] Least ratio of the level before the hit to that at the end of the record. Why: noise is
    #: equal at both; a rule of thumb.
    over_end: float = 3.0
    #: [1] Least share of the power of noise that earlier samples do not predict linearly. Why: 7/8
    #: for white noise, a half for half white and half slow noise, 0 for modes.
    unpredicted_share: float = 0.3
    #: [samples] Number of earlier samples of this prediction. Why: twice the number of modes that
    #: dominate the end of a record; a rule of thumb.
    prediction_order: int = 8
    #: [1] Ratio of the rms in the third quarter of a response to that in the last, below which it
    #: does not decay. Why: 1 for a steady wave, 1.1 for a mode that loses a third of its motion in
    #: the record.
    steady_ratio: float = 1.1


@dataclass(frozen=True)
class PulseSettings:
    """Numbers of the check that the force of a hit is a pulse."""

    #: [1] Share of the energy that defines the duration of a signal. Why: a common definition.
    energy_share: float = 0.9
    #: [1] Samples above this share of the largest contribute to the energy. Why: the remaining ones
    #: are noise.
    loud_share: float = 0.05
    #: [1] Least ratio of |sum| to the sum of absolute values of a signal of one sign. Why: 1 for
    #: half a sine.
    one_sign: float = 0.8
    #: [1] Largest ratio of |sum| to the sum of absolute values of an oscillation. Why: 0 for a free
    #: vibration.
    oscillation: float = 0.5
    #: [1] Least ratio of the durations of an oscillation and of a pulse. Why: a rule of thumb.
    duration_ratio: float = 4.0


@dataclass(frozen=True)
class RecordPeakSettings:
    """Numbers of the peaks that are compared between records."""

    #: [peaks] Number of peaks evaluated, the largest. Why: a rule of thumb; each further one may be
    #: noise.
    most_peaks: int = 5
    #: [1] The lines of a peak are those above this share of it. Why: a little more than the
    #: half-power band; a rule of thumb.
    flank_share: float = 0.35


@dataclass(frozen=True)
class LevelDependenceSettings:
    """Numbers of the test for FRFs that depend on the level of hits."""

    #: [hits] Least number of hits. Why: with three, a regression has one degree of freedom.
    least_hits: int = 4
    #: [1] Least ratio of the strongest hit to the weakest. Why: with less, a change is not
    #: attributable to the level; a rule of thumb.
    least_range: float = 1.25
    #: [1] Least relevant change of the shape of a peak. Why: smaller changes do not affect a fit; a
    #: rule of thumb.
    least_change: float = 0.03
    #: [1] Probability of such a change by chance at one peak. Why: level 0.5 % of an F test.
    false_alarm: float = 0.005
    #: [1] Number of blocks of a record for the decay of its level. Why: a rule of thumb.
    blocks: int = 200
    #: [1] Least ratio of the rms of a block to that of the noise at the end, for a response. Why: a
    #: rule of thumb.
    loud_ratio: float = 2.0


@dataclass(frozen=True)
class SegmentLeakageSettings:
    """Numbers of the test for leakage of segments."""

    #: [1] Least relevant loss of a peak to leakage. Why: it changes a loss factor by about as much;
    #: a rule of thumb.
    least_loss: float = 0.1
    #: [std] Number of standard deviations by which the loss exceeds this. Why: level 6 % of a
    #: one-sided t test with four degrees of freedom, one less than `parts`.
    least_stds: float = 2.0
    #: [parts] Number of parts of the records for the standard deviation. Why: fewer give a standard
    #: deviation that is too uncertain; a rule of thumb.
    parts: int = 5
    #: [segments] Least number of segments of a part. Why: H1 of fewer is biased; a rule of thumb.
    segments_per_part: int = 3


@dataclass(frozen=True)
class DriftSettings:
    """Numbers of the test for drift of an offset."""

    #: [pieces] Number of pieces of a record whose means are offsets. Why: a rule of thumb.
    pieces: int = 20
    #: [1] Least drift as a share of the largest value. Why: smaller ones affect only lines near 0
    #: Hz; a rule of thumb.
    least_share: float = 0.01
    #: [1] Least t value of the slope of the offsets. Why: a rule of thumb; much higher than for
    #: independent offsets, since these are correlated.
    least_t: float = 12.0
    #: [std] Least difference of the offset from that before the hit, in standard deviations of the
    #: offsets. Why: slow modes are not drift; a rule of thumb.
    over_spread: float = 4.0
    #: [std] Least difference of the offset from that before the hit, in standard errors of the
    #: latter. Why: a rule of thumb; much higher than for independent samples, since these are
    #: correlated.
    over_error: float = 8.0
    #: [samples] Number of samples before the hit that determine an offset. Why: with fewer, its
    #: standard error is uncertain; a rule of thumb.
    least_samples_before: int = 64


@dataclass(frozen=True)
class MainsSettings:
    """Numbers of the search for lines of the mains."""

    #: [Hz] Deviation of the frequency of the mains from its nominal value. Why: a rule of thumb for
    #: public grids.
    frequency_deviation: float = 0.15
    #: [1] Number of harmonics evaluated, with the fundamental. Why: higher ones are weaker.
    harmonics: int = 3
    #: [1] Least ratio of the power of a line to that of its surroundings. Why: noise reaches it
    #: with a probability of 1e-9 (exponential distribution with the median as level).
    over_surroundings: float = 30.0
    #: [1] Largest relative change of the amplitude from one half to the next. Why: a mode decays
    #: more.
    steady_change: float = 0.25
    #: [1] Least share of the spectrum of the whole record. Why: a rule of thumb.
    least_share: float = 0.05
    #: [s] Least length of a half. Why: in shorter ones a mode decays too little to be
    #: distinguished.
    least_half: float = 0.2
    #: [1] Factor by which lines are interpolated. Effort: a window of Hann then loses less than 2 %
    #: of an amplitude between lines.
    interpolation: int = 4
    #: [lines] First line of the surroundings on either side. Why: the window of Hann has its main
    #: lobe in two lines.
    first_adjacent: int = 3
    #: [lines] Last line of the surroundings on either side. Why: a median of 12 values.
    last_adjacent: int = 8


@dataclass(frozen=True)
class NoiseFloorSettings:
    """Numbers of the test whether a response is above the noise."""

    #: [dB] Required ratio of response to noise. Why: twice the power of the noise.
    least_ratio: float = 3.0
    #: [1] Largest share of lines without this ratio. Why: responses also have lines without motion
    #: (antiresonances); a rule of thumb.
    most_faint_share: float = 0.45
    #: [samples] Least number of samples of a record. Why: shorter ends do not determine the noise.
    least_samples: int = 256


CLIPPING = ClippingSettings()
HIT_FORCE = HitForceSettings()
HIT_RESPONSE = HitResponseSettings()
PULSE = PulseSettings()
RECORD_PEAK = RecordPeakSettings()
LEVEL_DEPENDENCE = LevelDependenceSettings()
SEGMENT_LEAKAGE = SegmentLeakageSettings()
DRIFT = DriftSettings()
MAINS = MainsSettings()
NOISE_FLOOR = NoiseFloorSettings()
