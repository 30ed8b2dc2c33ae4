"""Builders of models: beams, and later drive trains, frames and solids."""
