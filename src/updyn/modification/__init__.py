"""Effects of a change of the structure, predicted by an updated model before it is made."""
