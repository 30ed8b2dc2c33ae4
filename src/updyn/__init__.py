"""updyn: finite-element model updating from measured frequency response functions."""

__version__ = "0.1.0"
