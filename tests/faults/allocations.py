"""The memory of the simulator: each array that our own Python makes is a point of the run."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np

from tests.faults.points import Points

_CALLS = ("empty", "zeros", "full", "concatenate", "stack")
_OURS = ("tilepipe", "bright_spots")


@contextmanager
def watched_allocations(points: Points) -> Iterator[None]:
    """Let the arrays that our modules ask numpy for pass through the points."""
    with ExitStack() as patches:
        for name in _CALLS:
            patches.enter_context(patch.object(np, name, _call(getattr(np, name), points)))
        yield


def _call(function: Callable[..., Any], points: Points) -> Callable[..., Any]:
    def called(*arguments: Any, **named: Any) -> Any:
        if sys._getframe(1).f_globals.get("__name__", "").startswith(_OURS):
            points.reach("allocation")
        return function(*arguments, **named)

    return called
