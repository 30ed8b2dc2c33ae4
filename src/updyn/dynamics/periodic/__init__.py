"""Periodic response of models with nonlinear elements, by harmonic balance."""
