"""Place and kind of a local nonlinearity, from FRFs at several force levels."""
