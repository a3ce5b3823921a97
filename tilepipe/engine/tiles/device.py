"""Tiles on a GPU: a stream for each thread; a tile that does not fit tries again with the device to itself."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from tilepipe.errors import InputError
from tilepipe.tiling.grid import Tile
from tilepipe_kernels.core.arrays import Backend
from tilepipe_kernels.core.device_memory import (
    device_stream,
    free_device_memory,
    is_out_of_memory,
    limit_device_memory,
)

Result = TypeVar("Result")


class _Device:
    """Who uses the device: many threads together, or one alone."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._together = 0
        self._waiting = 0

    @contextmanager
    def together(self) -> Iterator[None]:
        with self._changed:
            # nobody begins while somebody waits to be alone, or that wait could last forever
            self._changed.wait_for(lambda: self._waiting == 0)
            self._together += 1
        try:
            yield
        finally:
            with self._changed:
                self._together -= 1
                self._changed.notify_all()

    @contextmanager
    def alone(self) -> Iterator[None]:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting == 0)
            self._waiting += 1
            self._changed.wait_for(lambda: self._together == 0)
        try:
            yield
        finally:
            with self._changed:
                self._waiting -= 1
                self._changed.notify_all()


_DEVICE = _Device()


def on_device(compute: Callable[[], Result], tile: Tile, limit: int) -> Result:
    """Compute a tile on the device.

    Parameters
    ----------
    compute
        What to do; called a second time, with nothing else on the device, if its memory was too small.
    tile
        For the message.
    limit
        Most memory of the device that this process may use, in bytes.

    Raises
    ------
    InputError
        When the tile does not even fit alone; says which tile size to use.  What other tiles have finished stays.
    """
    try:
        with _DEVICE.together(), device_stream():
            limit_device_memory(limit)
            return compute()
    except Exception as error:
        if not is_out_of_memory(error):
            raise
    with _DEVICE.alone(), device_stream():
        free_device_memory()
        try:
            return compute()
        except Exception as error:
            if not is_out_of_memory(error):
                raise
            side = max(tile.core.shape)
            raise InputError(
                f"the memory of the GPU, or --memory, is too small for tiles of {side} pixels with their halo "
                f"({tile.padded.columns} x {tile.padded.rows}); use --tile {max(side // 2, 1)} or a larger --memory"
            ) from error


@contextmanager
def fitting(what: str, advice: str, backend: Backend) -> Iterator[None]:
    """Say what to do when something that is no tile does not fit in the memory of the device.

    With the backend cupy it begins with what the tiles have left free.

    Raises
    ------
    InputError
        Instead of the error of the device's memory.
    """
    if backend == "cupy":
        free_device_memory()
    try:
        yield
    except Exception as error:
        if not is_out_of_memory(error):
            raise
        raise InputError(f"the memory of the GPU, or --memory, is too small for {what}; {advice}") from error
