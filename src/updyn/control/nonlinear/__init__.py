"""Loops with backlash or Coulomb friction: limit cycles by harmonic balance; simulation."""
