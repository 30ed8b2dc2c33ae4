"""Model updating: unknowns, residuals, methods of the fit, and assessment of the result."""
