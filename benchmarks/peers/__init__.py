"""Other programs for the same numbers, each timed on the same model once its answer is the same.

A peer is a module with ``tables(options)``, which yields what `measure.show` prints. One that needs
a package which is not installed says so and is skipped. None is a dependency of updyn.
"""
