"""Ansys Mechanical APDL: models from ``.full`` and ``.emat`` files, and updated properties."""
