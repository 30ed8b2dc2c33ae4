"""Structures of one design that differ: mean and scatter of their unknowns."""
