"""Other ways to the same numbers, each timed beside updyn on the same model after it gave the same answer.

A peer is a module with ``tables(options)``, which yields what `measure.show` prints. One that needs
a package which is not installed says so and is skipped. None is a dependency of updyn."""
