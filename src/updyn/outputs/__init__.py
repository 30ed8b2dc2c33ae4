"""Writing of results: updyn replaces only its own files, and a set of files at once.

A file that ``manifest.json`` does not list, or that has changed since, belongs to a user and is
neither replaced nor removed.
"""
