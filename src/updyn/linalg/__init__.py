"""Sparse factorisations with a common protocol."""
