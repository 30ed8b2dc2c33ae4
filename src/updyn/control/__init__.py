"""The plant: what an updated model is for the designer of a servo."""
