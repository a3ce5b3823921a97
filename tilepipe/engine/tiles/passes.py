"""Run one pass: a function of one tile and its halo over all tiles, anywhere, in any order, resumable.

A pass reads a raster and earlier state, writes the cores of its state arrays and returns the tile's *facts*, small
named arrays that a reconciliation needs.  When both are on disk the tile is done.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from tilepipe.engine.progress import Progress
from tilepipe.engine.tiles.device import on_device
from tilepipe.engine.tiles.executors import Executor
from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.tiles.state import StateArray, is_whole
from tilepipe.errors import InputError, TileError, WorkerError
from tilepipe.io.files.identity import ChangedInputError
from tilepipe.io.rasters.reads import noted_reads
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid
from tilepipe_kernels.core.arrays import Backend, to_host

READS = "reads"
"""Name of the fact that holds what a tile has read of the inputs; see `tilepipe.io.rasters.reads`."""

_NEWS = 60
"""Longest that a network file system may show a folder as it was, in seconds: ``acdirmax`` of nfs(5)."""

TileFunction = Callable[[Any, Tile], Facts]


@dataclass(frozen=True)
class BoundPass:
    """A pass with all that one run gives it.

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
    backend: Backend = "numpy"
    device_memory: int = 8 << 30


def _run_tile(bound: BoundPass, folder: Path, tile: Tile) -> int:
    """Compute one tile and record it; runs on a worker."""
    compute = partial(_facts_on_host, bound, tile)
    with noted_reads() as reads:
        try:
            facts = compute() if bound.backend == "numpy" else on_device(compute, tile, bound.device_memory)
        finally:
            # whatever came of it, what an input held half way while it was replaced tells nothing
            reads.check()
    Ledger(folder).record(tile.name, {**facts, READS: reads.table()})
    return tile.number


def _facts_on_host(bound: BoundPass, tile: Tile) -> Facts:
    return {name: to_host(value) for name, value in bound.function(bound.context, tile).items()}


def run_pass(bound: BoundPass, state: Path, executor: Executor, progress: Progress, *, verify: bool = True) -> Ledger:
    """Run a pass on all tiles that are not done yet.

    Parameters
    ----------
    bound
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
    ChangedInputError
        As soon as a tile finds an input changed; of no use to anyone, that tile is not recorded.
    """
    ledger = Ledger(state / bound.name)
    for array in bound.writes.values():
        array.create()
    tiles = list(bound.grid.tiles(bound.halo))
    marked = ledger.done()
    finished = {t.number for t in tiles if t.name in marked and (not verify or _verified(bound, ledger, t))}
    todo = [tile for tile in tiles if tile.number not in finished]
    progress.start(bound.name, len(tiles), len(finished))
    failures: list[tuple[Tile, BaseException]] = []
    computed: list[Tile] = []
    for tile, _, error in executor.run(partial(_run_tile, bound, ledger.folder), todo):
        if error is None:
            progress.advance(bound.name)
            computed.append(tile)
        elif isinstance(error, ChangedInputError):
            raise error
        else:
            failures.append((tile, error))
    failures += _unseen(ledger, computed)
    if failures:
        raise _tile_error(bound.name, failures, len(tiles))
    return ledger


def _unseen(ledger: Ledger, tiles: Sequence[Tile]) -> list[tuple[Tile, BaseException]]:
    """Tiles whose facts do not lie here whole, whatever their workers say: these may see another disk."""
    failures: list[tuple[Tile, BaseException]] = []
    end = time.monotonic() + _NEWS
    for tile in tiles:
        try:
            while not ledger.is_done(tile.name):
                if time.monotonic() > end:
                    reason = "its facts cannot be seen here: do all workers share the folder of the run?"
                    raise FileNotFoundError(reason)
                time.sleep(1)
        except (OSError, ValueError) as error:
            failures.append((tile, error))
    return failures


def _tile_error(name: str, failures: Sequence[tuple[Tile, BaseException]], total: int) -> TileError:
    failures = sorted(failures, key=lambda failure: failure[0].number)
    tile, error = failures[0]
    window = tile.core
    reason = (str(error).splitlines() or [""])[0]
    if not isinstance(error, InputError | WorkerError):
        reason = f"{type(error).__name__}: {reason}" if reason else type(error).__name__
    more = f" and {len(failures) - 1} more tiles" if len(failures) > 1 else ""
    place = f"rows {window.top}:{window.bottom}, columns {window.left}:{window.right}"
    failed = TileError(
        f"pass {name}: tile {tile.name} ({place}){more} of {total} failed: {reason}; "
        "nothing is published, the other tiles are kept: mend the cause and run the same command again"
    )
    failed.__cause__ = error
    return failed


def _verified(bound: BoundPass, ledger: Ledger, tile: Tile) -> bool:
    """Whether a tile marked as done is whole on disk; if not it is forgotten."""
    try:
        whole = is_whole(bound.writes, tile, ledger.facts(tile.name))
    except Exception:
        whole = False
    if not whole:
        ledger.forget(tile.name)
    return whole
