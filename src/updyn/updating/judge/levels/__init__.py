"""Dependence of measured FRFs on the force amplitude: tests, change of modes, place and kind."""
