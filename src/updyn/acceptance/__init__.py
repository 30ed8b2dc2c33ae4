"""Acceptance of a model by the limits of a standard for the agreement with measured modes."""
