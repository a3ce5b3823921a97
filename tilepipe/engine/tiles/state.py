"""Intermediate results of a run: Zarr arrays of which each tile writes its own core.

What a tile has written is noted among its facts by a checksum, so that a later run can verify it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.tiles.facts_file import checksum
from tilepipe.io.files.durable import atomic_write_bytes
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid, Window
from tilepipe_kernels.core.arrays import to_host

_CHUNK = 1024
"""Largest chunk of a state array, in pixels: small enough that halos cost little to read."""

_CHECKSUM = "checksum:"
"""What the names of the facts that hold checksums begin with."""


@dataclass(frozen=True)
class StateArray:
    """A raster of intermediate results in a Zarr array on ``grid``; each tile writes its core and no other chunk.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from tilepipe.engine.tiles.state import StateArray
    >>> from tilepipe.tiling.grid import TileGrid, Window
    >>> ids = StateArray(Path("ids"), TileGrid((4, 6), (4, 3)), "uint32")
    >>> ids.create()
    >>> _ = ids.write(ids.grid.tile(1), np.full((4, 3), 7, np.uint32))
    >>> ids.read(Window(0, 0, 1, 6)).tolist()
    [[0, 0, 0, 7, 7, 7]]
    """

    path: Path
    grid: TileGrid
    dtype: str
    fill: int = 0

    def create(self) -> None:
        """Create the array unless it is there as it was created; a damaged one is made anew, empty."""
        if not self._is_created():
            self._create_in(_lasting_store()(self.path))

    def _create_in(self, store: Any) -> Any:
        import zarr
        from zarr.codecs import BloscCodec

        return zarr.create_array(
            store,
            shape=self.grid.shape,
            chunks=self._chunks,
            dtype=self.dtype,
            fill_value=self.fill,
            compressors=BloscCodec(cname="lz4", clevel=1, shuffle="shuffle"),
            overwrite=True,
        )

    def _is_created(self) -> bool:
        from zarr.storage import MemoryStore

        if not (self.path / "zarr.json").is_file():
            return False
        try:
            found = _open_array(self.path).metadata.to_dict()
        # whatever a damaged description makes zarr say
        except Exception:
            return False
        return bool(found == self._create_in(MemoryStore()).metadata.to_dict())

    @property
    def _chunks(self) -> tuple[int, ...]:
        return tuple(_chunk(size) for size in self.grid.tile_shape)

    def read(self, window: Window) -> NDArray[Any]:
        """Values of a window."""
        return np.asarray(_open_array(self.path)[window.slices])

    def write(self, tile: Tile, values: NDArray[Any]) -> int:
        """Write the core of a tile of this array's grid; returns the checksum of what was written."""
        values = np.asarray(to_host(values))
        if values.dtype.kind == "f" and np.dtype(self.dtype).kind != "f":
            raise ValueError(f"tile {tile.name} writes {values.dtype} into {self.path.stem}, which holds {self.dtype}")
        values = np.ascontiguousarray(values, dtype=self.dtype)
        if values.shape != tile.core.shape:
            raise ValueError(f"tile {tile.name} writes {values.shape} into a core of {tile.core.shape}")
        _open_array(self.path)[tile.core.slices] = values
        return checksum(values)

    def checksum(self, tile: Tile) -> int:
        """Checksum of a tile's core as it lies on disk."""
        return checksum(self.read(tile.core))


def _chunk(size: int) -> int:
    """Largest divisor of a tile's size that is at most `_CHUNK`; the size itself when its divisors are tiny."""
    divisor = next(d for d in range(min(size, _CHUNK), 0, -1) if size % d == 0)
    return divisor if divisor >= min(size, _CHUNK // 4) else size


def _open_array(path: Path) -> Any:
    # a later run may make another array of the same name, so the handle is kept per version of its metadata
    return _opened_array(path, (path / "zarr.json").stat().st_mtime_ns)


@lru_cache(maxsize=64)
def _opened_array(path: Path, _version: int) -> Any:
    import zarr

    return zarr.open_array(_lasting_store()(path), mode="r+")


@cache
def _lasting_store() -> Any:
    """Kind of store that makes no folder above its own anew: where the state is gone, another run has begun."""
    from zarr.storage import LocalStore

    class LastingStore(LocalStore):
        def __init__(self, root: Path, **named: Any) -> None:
            super().__init__(root, **named)
            # to open it would make all folders above
            self._is_open = True

        async def set(self, key: str, value: Any) -> None:
            await asyncio.to_thread(self.set_sync, key, value)

        def set_sync(self, key: str, value: Any) -> None:
            _write_below(self.root, key, memoryview(value.as_numpy_array()))

    return LastingStore


def _write_below(root: Path, key: str, content: memoryview) -> None:
    """Write a file in one step; of the folders that lead to it only `root` and those below it are made."""
    path = root / key
    try:
        for folder in reversed([each for each in path.parents if each.is_relative_to(root)]):
            folder.mkdir(exist_ok=True)
        atomic_write_bytes(path, content)
    except FileNotFoundError:
        raise FileNotFoundError(f"{root}: the state is gone, for another run has begun") from None


def write_state(arrays: Mapping[str, StateArray], tile: Tile, values: Mapping[str, NDArray[Any]]) -> Facts:
    """Write the cores of state arrays; returns the checksums as facts, to be returned by the tile function."""
    facts: Facts = {}
    for name, array in arrays.items():
        own = array.grid.tile(tile.number)
        facts[_CHECKSUM + name] = np.array([array.write(own, values[name])], dtype=np.uint32)
    return facts


def is_whole(arrays: Mapping[str, StateArray], tile: Tile, facts: Facts) -> bool:
    """Whether a tile's cores lie on disk as `write_state` has noted in its facts."""
    return all(
        int(facts[_CHECKSUM + name][0]) == array.checksum(array.grid.tile(tile.number))
        for name, array in arrays.items()
    )
