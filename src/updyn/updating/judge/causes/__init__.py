"""Probable causes of a misfit: faults of the data or of the model that explain it."""
