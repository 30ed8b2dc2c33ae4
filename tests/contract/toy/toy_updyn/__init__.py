"""A package that extends updyn from outside: one object of each kind, one entry point each."""
