"""``kernels``: every kernel and the engine beside their peers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from benchmarks.kernels import clouds, engine, lines, skeletons, smoothing, surfaces
from benchmarks.kernels.scene import Scene
from benchmarks.measure.commands import scratch_folder
from benchmarks.measure.contest import Case, Measurement, measure
from benchmarks.measure.machine import describe_machine
from benchmarks.measure.tables import LEGEND, RESULTS, comparison, save

SIZE, QUICK_SIZE = 2048, 1024
ENGINE_SIZE = 8192


def cases(size: int, engine_size: int, scratch: Path, only: str = "") -> Iterator[Case]:
    """All cases on a scene of ``size`` pixels a side whose name holds ``only``."""
    scene = Scene(size)
    makers = (
        lambda: smoothing.diffusion_case(scene, 20),
        lambda: smoothing.diffusion_case(scene, 50),
        lambda: smoothing.regions_case(scene),
        lambda: smoothing.table_case(scene),
        lambda: lines.points_case(scene),
        lambda: lines.linked_case(scene),
        lambda: skeletons.skeleton_case(scene),
        lambda: skeletons.pruning_case(scene),
        lambda: clouds.gridding_case(size, "nearest"),
        lambda: clouds.gridding_case(size, "mean"),
        lambda: surfaces.quadtree_case(scene),
        lambda: surfaces.contacts_case(scene),
        lambda: surfaces.sampler_case(scene),
        lambda: surfaces.polygons_case(scene),
        lambda: engine.engine_case(scene, engine_size, scratch),
    )
    for make in makers:
        case = make()
        if only in case.name:
            yield case


def run_kernels(
    *,
    size: int = SIZE,
    engine_size: int = ENGINE_SIZE,
    repetitions: int = 3,
    peers: bool = True,
    patience: float = 20.0,
    only: str = "",
    scratch: Path | None = None,
    results: Path | None = RESULTS,
) -> list[tuple[Case, list[Measurement]]]:
    """Measure all cases, print each table and write the page.

    Parameters
    ----------
    size, engine_size
        Sides of the kernels' scene and of the engine's raster in pixels.
    repetitions
        Rounds after the warm-up.
    peers
        Whether the peers run too.
    patience
        Seconds; see `benchmarks.measure.contest.measure`.
    only
        Measures the cases whose name holds this.
    scratch
        Folder for temporary files; the system's by default.
    results
        Folder of the page; None writes none.

    Returns
    -------
    list of (Case, list of Measurement)
        What was measured.
    """
    machine = describe_machine()
    machine.announce()
    measured: list[tuple[Case, list[Measurement]]] = []
    with scratch_folder(scratch) as folder:
        for case in cases(size, engine_size, folder, only):
            found = measure(case, workers=machine.cores, repetitions=repetitions, peers=peers, patience=patience)
            measured.append((case, found))
            comparison("", [(case, found)], machine).show()
    title = f"Scene of {size} × {size} pixels, engine on {engine_size} × {engine_size}, {repetitions} rounds"
    if results is not None:
        save("kernels", machine, [LEGEND, "", comparison(title, measured, machine).markdown()], results)
    return measured
