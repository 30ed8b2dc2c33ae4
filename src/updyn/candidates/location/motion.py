"""`Motion`: the motion of an element at several levels, and its equivalent stiffness there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from updyn.arrays import ComplexArray, RealArray
from updyn.candidates.location.settings import LOCATION
from updyn.nonlinear.element import NonlinearElement
from updyn.nonlinear.gaussian import linearise
from updyn.nonlinear.over_lines import describe_first_harmonic

__all__ = ["Motion", "RandomMotion", "SineMotion"]


class Motion(Protocol):
    """The motion of an element at levels, lines and forces."""

    @property
    def typical(self) -> tuple[float, float]:
        """Amplitude of the deformation in m, and circular frequency in rad/s, of a middle level."""

    def describe(self, element: NonlinearElement) -> ComplexArray:
        """Return the force of an element over its deformation, (n_l, n_f, n_j); OptionError."""


@dataclass(frozen=True, slots=True, eq=False)
class SineMotion:
    """Amplitudes (n_l, n_f, n_j) in m of the deformation by sines at `omega` (n_f,) in rad/s."""

    amplitude: RealArray
    omega: RealArray

    @property
    def typical(self) -> tuple[float, float]:
        """Half the largest amplitude of a middle level, and its circular frequency."""
        middle = self.amplitude[len(self.amplitude) // 2].max(axis=1)
        peak = int(middle.argmax())
        return 0.5 * float(middle[peak]), float(self.omega[peak])

    def describe(self, element: NonlinearElement) -> ComplexArray:
        """Return the describing function."""
        of_velocity, omega = element.quantity == "mobility", self.omega[None, :, None]
        at = self.amplitude * omega if of_velocity else self.amplitude
        largest = at.max()
        least = max(float(at.min()), LOCATION.least_amplitude * largest)
        grid = np.geomspace(least, largest, LOCATION.table_points)
        N = _describe(element, grid)
        found = np.interp(at, grid, N.real) + 1j * np.interp(at, grid, N.imag)
        return np.asarray(found * omega if of_velocity else found)


@dataclass(frozen=True, slots=True, eq=False)
class RandomMotion:
    """Standard deviations (2, n_l, n_j) of deformation in m and velocity in m/s by random forces.

    `omega`, (n_f,), has the circular frequencies of the lines in rad/s.
    """

    spread: RealArray
    omega: RealArray

    @property
    def typical(self) -> tuple[float, float]:
        """The largest standard deviation of a middle level, and the ratio of both."""
        sigma, velocity = self.spread[:, self.spread.shape[1] // 2]
        j = int(sigma.argmax())
        return float(sigma[j]), float(velocity[j] / sigma[j])

    def describe(self, element: NonlinearElement) -> ComplexArray:
        """Return the dynamic stiffness of the equivalent springs and dampers."""
        flat = self.spread.reshape(2, -1).T.tolist()
        forces = [linearise(element, *one) for one in flat]
        shape = self.spread.shape[1:]
        k, c = (
            np.reshape(values, shape)[:, None]
            for values in zip(*[(one.stiffness, one.damping) for one in forces], strict=True)
        )
        return np.asarray(k + 1j * self.omega[None, :, None] * c)


def _describe(element: NonlinearElement, grid: RealArray) -> ComplexArray:
    """Return the describing function at 1 rad/s over the deformation, shape (n,)."""
    one = np.ones(len(grid))
    if not element.has_memory:
        return describe_first_harmonic(element, grid, one, LOCATION.samples)[0]
    # A loop is slow to follow, and has a closed form below macroslip.
    N = np.array(element.describing(grid, one))
    rest = ~np.isfinite(N)
    if rest.any():
        N[rest] = describe_first_harmonic(element, grid[rest], one[rest], LOCATION.samples)[0]
    return N
