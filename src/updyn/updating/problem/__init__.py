"""The problem of an update: unknowns, data, noise, frequency lines and residuals."""
