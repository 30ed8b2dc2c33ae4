"""Order, window and losses, with workers that only exist on paper."""

from __future__ import annotations

from collections import Counter

import pytest

from updyn.engines.remote import LostError, Remote
from updyn.engines.settings import WORKERS
from updyn.errors import EngineError


class Paper(Remote):
    """Calls are worked on when their result is asked for; `losses` lists which of all calls to lose, by number."""

    def __init__(
        self, window: int | None = None, losses: tuple[int, ...] = (), also: int = 0
    ) -> None:
        super().__init__()
        self.window, self.losses, self.also = window, losses, also
        self.sent: list[object] = []
        self.calls: list[dict] = []
        self.most_open = 0
        self.dropped: list[object] = []

    def _send(self, shared):
        self.sent.append(shared)
        return ("handle", shared)

    def _submit(self, function, handle, item):
        self.calls.append(
            {"function": function, "shared": handle[1], "item": item, "number": len(self.calls)}
        )
        self.most_open = max(self.most_open, sum("done" not in c for c in self.calls))
        return self.calls[-1]

    def _result(self, call):
        if call["number"] in self.losses:
            for other in self.calls[call["number"] : call["number"] + 1 + self.also]:
                other["lost"] = other["done"] = True  # what is behind it goes as well
            raise LostError("out of memory")
        call["done"] = True
        return call["function"](call["shared"], call["item"])

    def _is_lost(self, call):
        return "lost" in call

    def _drop(self, calls):
        self.dropped += [c["item"] for c in calls]

    def submissions(self):
        return Counter(c["item"] for c in self.calls)


def plus(shared, item):
    return shared[0] + item


@pytest.mark.parametrize(("window", "most"), [(None, 9), (3, 3), (1, 1), (50, 9)])
def test_order_and_window(window, most):
    engine = Paper(window)
    assert list(engine.map(plus, [10], range(9))) == list(range(10, 19))
    assert (engine.most_open, engine.dropped) == (most, [])
    assert set(engine.submissions().values()) == {1}


def test_only_what_was_lost_is_submitted_again():
    engine = Paper(4, losses=(2,), also=1)
    assert list(engine.map(plus, [10], range(6))) == list(range(10, 16))
    assert engine.submissions() == {0: 1, 1: 1, 2: 2, 3: 2, 4: 1, 5: 1}


def test_losses_with_results_in_between_are_borne_without_end():
    engine = Paper(1, losses=tuple(range(0, 40, 2)))
    assert list(engine.map(plus, [0], range(20))) == list(range(20))


def test_losses_in_a_row_are_borne_so_many_times():
    losses = tuple(range(1, 1 + WORKERS.most_losses))
    assert list(Paper(1, losses=losses).map(plus, [0], range(3))) == [
        0,
        1,
        2,
    ]
    engine = Paper(2, losses=tuple(range(1, 20)))
    results = engine.map(plus, [0], range(5))
    assert next(results) == 0
    with pytest.raises(
        EngineError, match=r"^workers were lost 4 times in a row at item 2 of 5: out of memory$"
    ):
        next(results)
    assert engine.dropped == [1, 2]


def test_what_nobody_waits_for_is_dropped():
    engine = Paper(3)
    results = engine.map(plus, [0], range(9))
    assert next(results) == 0
    results.close()
    assert engine.dropped == [1, 2]
    assert next(engine.map(plus, [5], [1])) == 6


def test_an_error_drops_the_rest():
    engine = Paper(3)
    with pytest.raises(ZeroDivisionError):
        list(engine.map(lambda _, item: 1 / item, [], [0, 1, 2, 3]))
    assert engine.dropped == [0, 1, 2]


def test_the_latest_two_are_remembered_by_identity():
    engine, a, b, c = Paper(), [1], [1], [2]
    for shared in (a, b, a, b, c, b, c, a):
        list(engine.map(plus, shared, [0]))
    assert [id(s) for s in engine.sent] == [id(s) for s in (a, b, c, a)]
