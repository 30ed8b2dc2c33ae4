"""An engine: one process that works on the items from the last to the first."""


class Backwards:
    """Items are worked on backwards, and handed out forwards."""

    expects = "'backwards'"
    workers = 2
    name = "backwards"

    @classmethod
    def from_option(cls, option):
        """Return the engine for the text 'backwards'."""
        return cls() if option == "backwards" else None

    def map(self, function, shared, items):
        """Yield the results in the order of the items."""
        done = [function(shared, item) for item in reversed(items)]
        yield from reversed(done)

    def close(self):
        """Nothing was started."""
