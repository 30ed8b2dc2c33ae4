"""A residual: difference of the inverse FRFs, relative to the measured one."""

from dataclasses import dataclass

from updyn.updating.problem.residuals import LineResidual


@dataclass(frozen=True, slots=True)
class InverseError(LineResidual):
    """r = H_X / H_A - 1."""

    name: str = "toy-residual"

    def block(self, part, x, lines):
        """Return residual and derivatives at a block of lines."""
        block = part.block(x, lines)
        ratio = block.measured / block.H
        return ratio - 1.0, -block.dH * ratio / block.H
