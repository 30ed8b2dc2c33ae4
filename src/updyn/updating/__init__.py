"""The unknowns, the residuals, the fit, and what it can be trusted for."""
