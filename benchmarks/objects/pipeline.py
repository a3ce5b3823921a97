"""`tilepipe objects` and its plain rival on one scene: run, watched from outside, and scored."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.measure.commands import Runs, pipeline, repeated_and_single, repeated_rival
from benchmarks.measure.machine import load_average
from benchmarks.objects.quality import PartitionScore, blocks_of, high_regions, score_buildings, score_partition
from benchmarks.objects.scenes import ObjectScene
from tilepipe.evaluate.polygons import AreaScore

LARGEST_SCORED = 70.0
"""Megapixels of the largest scene that is scored: scoring takes longer than the work."""
LARGEST_CHECKED = 3.0
"""Megapixels of the largest scene whose polygons are tested for a coverage: its time grows with the square."""

OURS, RIVAL = "**tilepipe objects**", "median, cc3d, dust"


@dataclass
class Outcome(Runs):
    """What one contestant did on one scene.

    Attributes
    ----------
    objects
        Number of polygons, where `objects.parquet` could be read.
    valid, coverage
        Whether all polygons are valid, and whether they neither overlap nor leave slits; None = not tested.
    covered
        Their area, as a share of the raster's valid pixels.
    partition
        Its objects against the true blocks.
    buildings
        Its buildings against the true ones, by the way they were told.
    """

    objects: int = 0
    valid: bool = False
    coverage: bool | None = None
    covered: float = 0.0
    partition: PartitionScore | None = None
    buildings: dict[str, AreaScore] = field(default_factory=dict)


def run_ours(scene: ObjectScene, out: Path, repetitions: int) -> Outcome:
    """Run `tilepipe objects` with its defaults; the first call of all should have compiled."""
    outcome = repeated_and_single(Outcome(OURS, scene, load=load_average()), ours(scene, out), out, repetitions)
    _score(outcome, out)
    return outcome


def ours(scene: ObjectScene, out: Path) -> list[str]:
    """The command of the pipeline."""
    return pipeline("objects", scene.raster, out)


def run_rival(scene: ObjectScene, out: Path, repetitions: int) -> Outcome:
    """Run `benchmarks.objects.rivals`."""
    command = [sys.executable, "-m", "benchmarks.objects.rivals", str(scene.raster), str(out)]
    outcome = repeated_rival(Outcome(RIVAL, scene, load=load_average()), command, out, repetitions)
    if not outcome.skipped:
        _score(outcome, out)
    return outcome


def _score(outcome: Outcome, out: Path) -> None:
    import geopandas
    import rasterio
    import shapely

    scene = outcome.scene
    if scene.megapixels > LARGEST_SCORED:
        return
    table = geopandas.read_parquet(out / "objects.parquet")
    polygons = table.geometry.to_numpy()
    with rasterio.open(scene.raster) as file:
        area = np.count_nonzero(file.read_masks(1)) * file.transform.a**2
    outcome.objects, outcome.covered = len(table), float(shapely.area(polygons).sum() / area)
    outcome.valid = bool(shapely.is_valid(polygons).all())
    if outcome.valid and scene.megapixels <= LARGEST_CHECKED:
        outcome.coverage = bool(shapely.coverage_is_valid(polygons))
    blocks = blocks_of(scene)
    outcome.partition = score_partition(shapely.make_valid(polygons), scene, blocks)
    high = np.isin(table.region_id, high_regions(scene.raster, out / "regions.tif"))
    outcome.buildings["objects 2.5 m above ground"] = score_buildings(polygons[high], scene.truth, scene)
    if (out / "buildings.parquet").exists():
        found = geopandas.read_parquet(out / "buildings.parquet").geometry.to_numpy()
        outcome.buildings["**buildings.parquet**"] = score_buildings(found, scene.truth, scene)
