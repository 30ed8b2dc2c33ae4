"""Uncertainty of an estimate: profile likelihood, bootstrap, sampling, and prediction bands."""
