"""Report sections, figures and page of a plant, its servo loops and non-linear elements."""
