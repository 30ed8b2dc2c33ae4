"""What the comparison counts of each fit."""

from updyn.comparison.bench import StepCounter
from updyn.updating.fit.monitor import Progress


def test_lines_of_the_judgement_are_not_those_of_the_method():
    counter = StepCounter(None)
    for stage, lines in (
        ("search", 30),
        ("faults of the data", 60),
        ("log", 90),
        ("judge", 120),
        ("causes", 6240),
    ):
        assert not counter(Progress(stage, 3, 1.0, lines, 30))
    assert counter.lines_solved == 90
