"""Results as figures, in one self-contained page."""
