"""The laws that every pipeline is put through: neither tiling nor workers nor interruption show in its layers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest.mock import patch

import pytest

from tilepipe.engine.options import RunOptions
from tilepipe.engine.tiles import passes
from tilepipe.errors import TileError
from tilepipe.io.files.record import RECORD, STATE, TIMINGS
from tilepipe.tiling.grid import Tile

Run = Callable[[Path, RunOptions], object]
"""Runs a pipeline on some scene into a folder."""

Worked = list[tuple[str, int]]
"""Pass and number of each tile that has been computed, in this order."""


class Killed(BaseException):
    """Stands for the end of the process."""


def layer_bytes(folder: Path) -> dict[str, bytes]:
    """Content of all layers that a run has published, by name."""
    files = (path for path in folder.iterdir() if path.is_file() and path.name not in (RECORD, TIMINGS))
    return {path.name: path.read_bytes() for path in files}


@contextmanager
def tiles(breaking: Callable[[str, Tile, Worked], BaseException | None] = lambda *_: None) -> Iterator[Worked]:
    """Note each tile that is computed in this process, unless `breaking` gives an error to raise instead."""
    run_tile, worked = passes._run_tile, Worked()

    def watched(bound: passes.BoundPass, folder: Path, tile: Tile) -> int:
        if error := breaking(bound.name, tile, worked):
            raise error
        number = run_tile(bound, folder, tile)
        worked.append((bound.name, tile.number))
        return number

    with patch.object(passes, "_run_tile", watched):
        yield worked


def assert_invisible(run: Run, folder: Path, whole: dict[str, bytes], choices: Iterable[RunOptions]) -> None:
    """The layers are these bytes with each choice of tile, workers and executor."""
    for number, options in enumerate(choices):
        run(folder / str(number), options)
        found = layer_bytes(folder / str(number))
        assert found.keys() == whole.keys()
        assert [name for name in whole if found[name] != whole[name]] == [], options


def assert_resumes(
    run: Run, folder: Path, whole: dict[str, bytes], options: RunOptions, failing: str | None = None, survived: int = 0
) -> Worked:
    """A run of which a tile fails, that is then killed and resumed, publishes these bytes and computes no tile twice.

    Parameters
    ----------
    run, folder, whole
        The run, its folder, and the layers that an undisturbed run has published.
    options
        With several tiles and one worker.
    failing
        Pass whose second tile fails at first; None where no tile fails.
    survived
        Tiles that the resumed run computes before it is killed.

    Returns
    -------
    list
        Pass and number of all tiles that have been computed.
    """
    worked: Worked = []
    if failing is not None:
        error = RuntimeError("the lights went out")
        named = rf"pass {failing}: tile \w+ .* of \d+ failed: RuntimeError: the lights went out"
        fails = tiles(lambda name, tile, _: error if (name, tile.number) == (failing, 1) else None)
        with fails as done, pytest.raises(TileError, match=named):
            run(folder, options)
        assert [path.name for path in folder.iterdir()] == [STATE]
        worked += done
    with tiles(lambda name, tile, done: Killed() if len(done) == survived else None) as done, pytest.raises(Killed):
        run(folder, options)
    assert [path.name for path in folder.iterdir()] == [STATE]
    worked += done
    with tiles() as done:
        run(folder, options)
    worked += done
    assert layer_bytes(folder) == whole
    assert not (folder / STATE).exists()
    assert len(set(worked)) == len(worked)
    return worked
