"""The executor of the simulator: tiles in any order, late, twice, or not at all."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any

from tests.faults.points import Points

Task = tuple[Callable[[Any], Any], Any]


class SimulatedExecutor:
    """Runs one item at a time, in an order of its own; each is a point of the run.

    Parameters
    ----------
    points
        Of the run.
    seed
        Decides the order, which results come late, and which items are computed twice.
    handed_out
        Receives all tasks; those of earlier runs in it are at times done among the own, as by workers that outlive
        their driver.
    """

    workers = 2

    def __init__(self, points: Points, seed: int, handed_out: list[Task] | None = None) -> None:
        self.points = points
        self.random = random.Random(seed)
        self.handed_out = [] if handed_out is None else handed_out
        self.earlier = list(self.handed_out)

    def run(self, function: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[tuple[Any, Any, Any]]:
        """See `tilepipe.engine.tiles.executors.Executor.run`."""
        order = list(items)
        self.random.shuffle(order)
        late: list[tuple[Any, Any, Any]] = []
        self.handed_out += [(function, item) for item in order]
        for item in order:
            self._outlive()
            late.append(self._outcome(function, item))
            if self.random.random() < 0.5:
                yield late.pop(self.random.randrange(len(late)))
        yield from late

    def _outcome(self, function: Callable[[Any], Any], item: Any) -> tuple[Any, Any, Any]:
        try:
            self.points.reach("task")
            result = function(item)
            if self.random.random() < 0.2:
                # a straggler that was handed out a second time
                result = function(item)
        except Exception as error:
            return item, None, error
        return item, result, None

    def _outlive(self) -> None:
        """At times, do what an earlier run has handed out; whether that succeeds is nobody's concern."""
        if self.earlier and not self.points.dead and self.random.random() < 0.5:
            function, item = self.random.choice(self.earlier)
            with suppress(Exception):
                function(item)
