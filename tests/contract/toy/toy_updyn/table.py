"""A table of the job file: ``[toy]``, the strain energy at a frequency."""

import json

from updyn.job.job_table import JobTable
from updyn.job.schema import Table


class ToyTable(Table):
    """``[toy]``."""

    file: str = "toy.json"


class Toy(JobTable):
    """Writes the factors of the unknowns."""

    schema = ToyTable

    def outputs(self, table):
        """Return the one file."""
        return (table.file,)

    def run(self, prepared, result, found, callback, engine):
        """Return the values."""
        return dict(result.values)

    def write(self, found, job, folder):
        """Write them."""
        (folder / job.table(ToyTable).file).write_text(json.dumps(found), encoding="utf-8")

    def summary(self, found):
        """Return a line."""
        return f"Toy: {len(found)} values."


TOY = Toy()
