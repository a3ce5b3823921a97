"""Run one pass: a function of one tile and its halo over all tiles, anywhere, in any order, resumable.

A pass reads a raster and earlier state, writes the cores of its state arrays and returns the tile's *facts*, small
named arrays that a reconciliation needs.  When both are on disk the tile is done.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from tilepipe.engine.device import on_device
from tilepipe.engine.executors import Executor
from tilepipe.engine.ledger import Ledger
from tilepipe.engine.progress import Progress
from tilepipe.engine.state import StateArray, is_whole
from tilepipe.errors import TileError
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid
from tilepipe_kernels.core.arrays import Backend, to_host

TileFunction = Callable[[Any, Tile], Facts]


@dataclass(frozen=True)
class Pass:
    """A computation that runs on every tile.

    Attributes
    ----------
    name
        Name in messages, progress and the state folder.
    function
        Module-level function ``function(context, tile) -> facts``; it writes state arrays through `write_state`.
    context
        Everything the function needs, picklable.
    grid
        Tiling.
    halo
        Width in pixels that the function reads around a core.
    writes
        State arrays that the function fills, by name.
    bytes_per_pixel
        Peak working memory of the function per pixel of the padded window, for planning.
    backend
        Whose arrays the function works on.
    device_memory
        Most memory of the device that a process may use, in bytes; of no account for numpy.
    """

    name: str
    function: TileFunction
    context: Any
    grid: TileGrid
    halo: int
    writes: Mapping[str, StateArray] = field(default_factory=dict)
    bytes_per_pixel: int = 16
    backend: Backend = "numpy"
    device_memory: int = 8 << 30

    def memory(self) -> int:
        """Peak working memory of one tile in bytes, halo included."""
        rows, columns = (min(t + 2 * self.halo, s) for t, s in zip(self.grid.tile_shape, self.grid.shape, strict=True))
        return rows * columns * self.bytes_per_pixel


def _run_tile(pass_: Pass, folder: Path, tile: Tile) -> int:
    """Compute one tile and record it; runs on a worker."""
    compute = partial(_facts_on_host, pass_, tile)
    facts = compute() if pass_.backend == "numpy" else on_device(compute, tile, pass_.device_memory)
    Ledger(folder).record(tile.name, facts)
    return tile.number


def _facts_on_host(pass_: Pass, tile: Tile) -> Facts:
    return {name: to_host(value) for name, value in pass_.function(pass_.context, tile).items()}


def run_pass(pass_: Pass, state: Path, executor: Executor, progress: Progress, *, verify: bool = True) -> Ledger:
    """Run a pass on all tiles that are not done yet.

    Parameters
    ----------
    pass_
        The pass.
    state
        Folder of the run's state; the pass keeps its ledger in ``state/<name>``.
    executor
        Where tiles are computed.
    progress
        Told about each finished tile.
    verify
        Compare the checksums of tiles finished by an earlier run with what lies on disk.

    Returns
    -------
    Ledger
        The pass's ledger; every tile is done.

    Raises
    ------
    TileError
        When tiles failed; all others are finished before it is raised, and it names them.
    """
    ledger = Ledger(state / pass_.name)
    for array in pass_.writes.values():
        array.create()
    tiles = list(pass_.grid.tiles(pass_.halo))
    marked = ledger.done()
    finished = {t.number for t in tiles if t.name in marked and (not verify or _verified(pass_, ledger, t))}
    todo = [tile for tile in tiles if tile.number not in finished]
    progress.start(pass_.name, len(tiles), len(finished))
    failures: list[tuple[Tile, BaseException]] = []
    for tile, _, error in executor.run(partial(_run_tile, pass_, ledger.folder), todo):
        if error is None:
            progress.advance(pass_.name)
        else:
            failures.append((tile, error))
    if failures:
        raise _tile_error(pass_.name, failures, len(tiles))
    return ledger


def _tile_error(name: str, failures: Sequence[tuple[Tile, BaseException]], total: int) -> TileError:
    failures = sorted(failures, key=lambda failure: failure[0].number)
    tile, error = failures[0]
    window = tile.core
    reason = (str(error).splitlines() or [""])[0] or type(error).__name__
    more = f" and {len(failures) - 1} more tiles" if len(failures) > 1 else ""
    place = f"rows {window.top}:{window.bottom}, columns {window.left}:{window.right}"
    failed = TileError(
        f"pass {name}: tile {tile.name} ({place}){more} of {total} failed: {reason}; "
        "nothing is published, the other tiles are kept: mend the cause and run the same command again"
    )
    failed.__cause__ = error
    return failed


def _verified(pass_: Pass, ledger: Ledger, tile: Tile) -> bool:
    """Whether a tile marked as done is whole on disk; if not it is forgotten."""
    try:
        whole = is_whole(pass_.writes, tile, ledger.facts(tile.name))
    except Exception:
        whole = False
    if not whole:
        ledger.forget(tile.name)
    return whole
