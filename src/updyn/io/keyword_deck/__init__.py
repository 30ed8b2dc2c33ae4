"""Input decks of the keyword family, which CalculiX and Abaqus share."""
