"""Plant files: MATLAB, JSON, npz and C header."""
