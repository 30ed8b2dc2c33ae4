"""Nastran: bulk data decks, OUTPUT4 and DMIG matrices, and models from decks by running MYSTRAN."""
