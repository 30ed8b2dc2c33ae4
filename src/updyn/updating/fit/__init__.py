"""The fit: methods, optimiser, search for a start, reduced tier, regularisation and checkpoints."""
