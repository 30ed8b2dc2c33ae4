"""Response function method with structural damping: complex stiffnesses (Lin & Zhu 2006)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from updyn.updating.fit.methods.rfm import ResponseFunctionMethod

__all__ = ["ComplexResponseFunctionMethod"]


@dataclass(frozen=True, slots=True)
class ComplexResponseFunctionMethod(ResponseFunctionMethod):
    """(h_A - h_X) = H_A dZ h_X with complex stiffnesses K_e (1 + i gamma_e) (method ``"complex-rfm"``).

    The response function method with the damping of the structure among its unknowns (Lin & Zhu,
    "Model updating of damped structures using FRF data", Mech. Syst. Signal Process. 20 (2006)
    2200-2218). Real rows stand over imaginary ones, masses are real, and the unknowns of a group's
    stiffness are the real and the imaginary part of kappa_e (1 + i gamma_e), in which Z is linear:
    one solve finds stiffness and loss factor from exact data.

    Damping is structural; viscous dampers of the model stand as given.

    Parameters
    ----------
    max_iterations : int
        Largest number of steps.
    tolerance : float
        Relative step at which it has converged.
    solver : {"gauss-newton", "trust-region"}
        As for ``"rfm"``; in the trust region the unknowns are kappa_e and gamma_e.
    expand : bool
        As for ``"rfm"``.
    """

    max_iterations: int = 300
    tolerance: float = 1e-10
    solver: str = "gauss-newton"
    expand: bool = False

    NAME: ClassVar[str] = "complex-rfm"
    reference: ClassVar[str] = "Lin & Zhu 2006"
    needs: ClassVar[str] = "every DOF measured (or expand = true)"
    cannot: ClassVar[tuple[str, ...]] = tuple(
        q for q in ResponseFunctionMethod.cannot if q != "loss_factor"
    )
    instead: ClassVar[str] = "its damping is structural; leave it out, or use the default"
