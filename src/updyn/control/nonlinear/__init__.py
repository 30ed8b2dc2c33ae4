"""Loops with one nonlinearity, backlash or Coulomb friction: limit cycles by harmonic balance, and in time."""
