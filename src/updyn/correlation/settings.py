"""Numbers that decide which modes are pairs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ModePairingSettings:
    """Numbers of the pairing of computed with measured modes."""

    #: [1] Largest relative difference of frequency of a pair. Why: a rule of thumb for models
    #: before updating.
    frequency_gate: float = 0.3
    #: [1] Least MAC of a pair of equal frequencies. Why: by Bessel's inequality, a shape has a
    #: MAC above one half with at most one shape of an orthogonal set.
    least_mac: float = 0.5
    #: [1] Modes within this relative difference of frequency are close. Why: frequencies of one
    #: structure vary by 0.22 % between assemblies (median of 26 elastic modes over 130 assemblies
    #: of AIRMOD; data of Patelli et al., Arch. Appl. Mech. 87 (2017) 905-925). A coupling of that
    #: size gives a MAC of 0.9 at a gap of 0.59 %, and less at smaller gaps; 0.9 is the usual limit
    #: for one mode.
    close_frequencies: float = 0.006
    #: [1] Weight of the squared difference of frequency (as a share of the gate) relative to MAC;
    #: it decides if the sensors cannot distinguish shapes. Why: requires a MAC of 0.9 at the gate.
    frequency_weight: float = 0.4
    #: [1] A shape is at rest at the sensors if they see less than this share of its largest
    #: component. Why: rounding of eigenvectors.
    rest_share: float = 1e-9
    #: [1] Directions in which shapes of unit length have a singular value below this share of the
    #: largest are excluded from their span. Why: measured shapes usually have errors of 10 %.
    least_spread: float = 0.1


@dataclass(frozen=True)
class ModelModesSettings:
    """Limits of the computation of modes for a comparison."""

    #: [DOFs] Largest model whose modes are computed as complex modes if it is damped. Effort: a
    #: rule of thumb.
    most_complex_dofs: int = 5_000
    #: [modes] Largest number of modes of a model. Effort: a rule of thumb.
    most_modes: int = 400


MODE_PAIRING = ModePairingSettings()
MODEL_MODES = ModelModesSettings()
