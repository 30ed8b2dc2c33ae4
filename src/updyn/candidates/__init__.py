"""Several models of one structure fitted to the same data, and compared."""
