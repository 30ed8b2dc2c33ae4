"""The plant: state-space models of updated structures for the design of servos."""
