"""Factorisations behind one small protocol."""
