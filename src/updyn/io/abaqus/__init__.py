"""Abaqus: matrix files, the decks that write and read them, and updated properties."""
