"""TODO-DOCSTRING of the room."""
