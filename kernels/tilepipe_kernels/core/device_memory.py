"""Memory of the device, and the streams by which threads share it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from tilepipe_kernels.core.arrays import device_namespace
from tilepipe_kernels.core.simulated import simulating


def limit_device_memory(limit: int) -> None:
    """Give the memory pool of this process a limit in bytes; more than the device has is no limit.

    An array that does not fit raises an error that `is_out_of_memory` knows.
    """
    if not simulating():
        pool = device_namespace().get_default_memory_pool()
        if pool.get_limit() != limit:
            pool.set_limit(size=limit)


def device_memory() -> int:
    """Bytes of memory that the device has."""
    return 1 << 40 if simulating() else int(device_namespace().cuda.Device().mem_info[1])


_DEVICE_ERRORS = frozenset(("OutOfMemoryError", "CUDARuntimeError", "CUDADriverError", "CudaAPIError", "CUDAError"))
"""Errors of cupy, of numba and of what launches numba's grids, among them those of memory that is too small."""


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error says that the memory of the device, or its limit, is too small.

    Examples
    --------
    >>> from tilepipe_kernels.core.device_memory import DeviceMemoryError, is_out_of_memory
    >>> is_out_of_memory(DeviceMemoryError()), is_out_of_memory(MemoryError("of the host"))
    (True, False)
    """
    text = str(error).lower().replace("_", " ")
    # a wrong address of memory is another matter
    too_small = "out of memory" in text or "memoryallocation" in text
    return isinstance(error, DeviceMemoryError) or (type(error).__name__ in _DEVICE_ERRORS and too_small)


class DeviceMemoryError(MemoryError):
    """The memory of the device is too small; also raised by tests, which have no device to fill."""


def free_device_memory() -> None:
    """Give back what the memory pool keeps for later."""
    if not simulating():
        device_namespace().get_default_memory_pool().free_all_blocks()


_threads = threading.local()


@contextmanager
def device_stream() -> Iterator[None]:
    """Queue this thread's work on a stream of its own, so that copies of one tile overlap with another's kernels."""
    if simulating():
        yield
        return
    stream = getattr(_threads, "stream", None)
    if stream is None:
        stream = _threads.stream = device_namespace().cuda.Stream(non_blocking=True)
    with stream:
        yield
        stream.synchronize()
