"""Local nonlinear elements: springs, gaps, friction, joints and dampers, each in its own module."""

from __future__ import annotations

from updyn.nonlinear.element import NonlinearElement
from updyn.registry import Registry

__all__ = ["ELEMENTS"]

#: Nonlinear elements by name.
ELEMENTS: Registry[type[NonlinearElement]] = Registry(
    "nonlinear element",
    "updyn.nonlinear_elements",
    {
        "cubic-spring": "updyn.nonlinear.cubic:CubicSpring",
        "polynomial-spring": "updyn.nonlinear.polynomial:PolynomialSpring",
        "backlash": "updyn.nonlinear.backlash:Backlash",
        "coulomb-friction": "updyn.nonlinear.friction:CoulombFriction",
        "jenkins": "updyn.nonlinear.jenkins:JenkinsElement",
        "iwan": "updyn.nonlinear.iwan:IwanJoint",
        "quadratic-damper": "updyn.nonlinear.damper:QuadraticDamper",
    },
)
