"""Causes of a misfit: faults of the data that explain it better than the unknowns can."""
