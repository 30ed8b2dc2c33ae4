"""Dynamic stiffness, responses, modes and exact dynamic condensation."""
