"""How site rules and loops are compiled.

A *rule* is a scalar function of the values at one site and holds a formula once.  A *loop* walks the sites of a
block on the CPU and calls rules.  The CUDA form of a kernel calls the very same rules from a grid of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def rule(function: Function) -> Function:
    """Compile a scalar site rule: scalars in, scalars out, no arrays, no fast-math, so that every backend agrees."""
    return cast(Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def loop(function: Function) -> Function:
    """Compile a serial CPU loop that releases the GIL; it must stand at module level to be found in the disk cache."""
    return cast(Function, numba.njit(cache=True, nogil=True, error_model="numpy")(function))
