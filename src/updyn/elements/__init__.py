"""Builders of models: beams, drive trains, structures in space and meshes, and the constraints that tie them."""
