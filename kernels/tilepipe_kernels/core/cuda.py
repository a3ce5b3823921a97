"""numba.cuda as device code sees it, on a GPU and where numba simulates one.

The simulator puts a stand-in for ``numba.cuda`` into the module of a kernel while that runs, and into that of a device
function while it is called: threads that call one at the same time take it from one another.  The stand-in here asks
for the running kernel's at every use instead.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from tilepipe_kernels.core.simulated import simulating


class _SimulatedCuda:
    """Names of the kernel that is being simulated; device functions are the Python functions themselves."""

    @staticmethod
    def jit(*, device: bool) -> Callable[[Any], Any]:
        return lambda function: function

    def __getattr__(self, name: str) -> Any:
        from numba.cuda.simulator.kernel import _get_kernel_context

        return getattr(_get_kernel_context(), name)


cuda: Any = _SimulatedCuda() if simulating() else importlib.import_module("numba.cuda")
