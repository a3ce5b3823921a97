"""One disturbed run: a fault at one point, what it may leave, and the resume that must give the bytes of a calm run."""

from __future__ import annotations

import random
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

from tests.faults import scenes
from tests.faults.allocations import watched_allocations
from tests.faults.files import watched_files
from tests.faults.points import FAULTS, Fault, Killed, Points
from tests.faults.tiles import SimulatedExecutor, Task
from tests.laws import layer_bytes
from tilepipe.engine import run as engine_run
from tilepipe.errors import InputError, TileError
from tilepipe.io.files.record import RECORD, STATE

CALM = Fault(-1, "kill")
"""No fault at all."""

EXPECTED = (InputError, TileError, Killed, KeyboardInterrupt, MemoryError)
"""How a disturbed run may end; all other errors are faults of ours."""


@dataclass(frozen=True)
class Outcome:
    """What happened in a disturbed run, and what was wrong afterwards; nothing, if all is well."""

    happened: str
    ended: str
    wrong: str = ""


@contextmanager
def simulated(points: Points, seed: int = 0, handed_out: list[Task] | None = None) -> Iterator[None]:
    """Let the run within pass through these points."""
    executor = SimulatedExecutor(points, seed, handed_out)

    @contextmanager
    def open_executor(*_: object) -> Iterator[SimulatedExecutor]:
        yield executor

    with patch.object(engine_run, "open_executor", open_executor):
        try:
            with watched_files(points), watched_allocations(points):
                yield
        finally:
            points.end()


@cache
def calm(name: str) -> tuple[dict[str, bytes], int]:
    """Layers of an undisturbed run, and the number of its points."""
    with TemporaryDirectory() as folder:
        raster = scenes.write_scene(Path(folder))
        out = Path(folder) / "runs" / "out"
        # the first run of a process loads and compiles, which allocates
        scenes.run(name, raster, out)
        shutil.rmtree(out)
        points = Points(out.parent, CALM)
        with simulated(points):
            scenes.run(name, raster, out)
        return layer_bytes(out), points.count


def disturb(name: str, fault: Fault, seed: int) -> Outcome:
    """Run a pipeline with a fault, resume it, and compare.

    Parameters
    ----------
    name
        Of the pipeline.
    fault
        What happens, and where.
    seed
        Decides the order of tiles and what the fault leaves open.
    """
    whole, _ = calm(name)
    with TemporaryDirectory() as folder:
        raster = scenes.write_scene(Path(folder))
        out = Path(folder) / "runs" / "out"
        out.parent.mkdir()
        points = Points(out.parent, fault, seed)
        ended, wrong = "well", ""
        try:
            with simulated(points, seed):
                scenes.run(name, raster, out)
        except EXPECTED as error:
            ended = type(error).__name__
        except BaseException as error:
            ended = wrong = f"ended with {type(error).__name__}: {error}"
        wrong = wrong or _what_is_wrong(out, whole) or _resumed(name, raster, out, whole)
        return Outcome(points.happened, ended, wrong)


def _what_is_wrong(out: Path, whole: dict[str, bytes]) -> str:
    """A folder that calls itself finished holds all layers; one that does not holds none of them as if it did."""
    if (out / RECORD).exists() and not (out / STATE).exists() and layer_bytes(out) != whole:
        return "a finished run without its layers"
    return ""


def _resumed(name: str, raster: Path, out: Path, whole: dict[str, bytes]) -> str:
    """Run the same command again, as a user would."""
    try:
        scenes.run(name, raster, out)
    except InputError as error:
        if "holds a finished run" not in str(error):
            return f"cannot be resumed: {error}"
    except Exception as error:
        return f"cannot be resumed: {type(error).__name__}: {error}"
    if (found := layer_bytes(out)) != whole:
        return f"other bytes: {sorted(key for key in whole if found.get(key) != whole[key]) or sorted(found)}"
    left = sorted(item.name for item in (*out.iterdir(), *out.parent.iterdir()) if item.name.startswith("."))
    return f"left behind: {left}" if left else ""


def draw_fault(name: str, seed: int) -> Fault:
    """A fault for a seed: any kind at any point of the run."""
    chosen = random.Random(seed)
    return Fault(chosen.randrange(calm(name)[1]), chosen.choice(FAULTS))


def disturb_seed(name: str, seed: int) -> tuple[str, int, str, Outcome]:
    """Name, seed, kind of its fault, and what came of it.

    Stands here since a new process finds no function of a main program.
    """
    fault = draw_fault(name, seed)
    return name, seed, fault.kind, disturb(name, fault, seed)
