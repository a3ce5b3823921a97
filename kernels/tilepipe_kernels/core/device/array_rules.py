"""Rules that read arrays, for grids."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from tilepipe_kernels.core.cuda import cuda

Function = TypeVar("Function", bound=Callable[..., Any])


def for_grids(rule: Function) -> Function:
    """Compile the very function of a rule that takes arrays for the device.

    Grids call scalar rules as they are, but where CUDA is simulated a compiled function does not take its arrays.
    """
    function: Any = rule
    return cast(Function, cuda.jit(device=True)(function.py_func))
