"""Reading and writing: one module a format, chosen by a lazy registry."""
