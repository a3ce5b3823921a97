"""The recipe of `objects` (Galvanin et al. 2007): what a run does, in the order of the paper's flow chart."""

from __future__ import annotations

from pathlib import Path

from tilepipe.engine.work import Work
from tilepipe.pipelines.objects.diagnostics import write_convergence
from tilepipe.pipelines.objects.pass_borders import BORDERS, RegionContext
from tilepipe.pipelines.objects.pass_leaves import LEAVES, LeafContext
from tilepipe.pipelines.objects.reconcile_buildings import tell_buildings
from tilepipe.pipelines.objects.reconcile_leaves import join_leaves
from tilepipe.pipelines.objects.reconcile_regions import merge_leaves
from tilepipe.pipelines.objects.tables import write_tables


def recipe(run: Work) -> list[Path]:
    """Squares, their graph, merged regions, borders, polygons: heights in, objects and their boundaries out."""
    # nobody holds the graph of the leaves once it has merged
    leaves, merged = merge_leaves(run, *join_leaves(run, run.over_tiles(LEAVES, LeafContext.of(run))))
    regions = RegionContext.of(run, leaves)
    with (
        run.beside(run.write_raster, "regions.tif", regions.read) as raster,
        run.beside(tell_buildings, run, leaves, merged) as buildings,
    ):
        borders = run.over_tiles(BORDERS, regions)
        tables = write_tables(run, borders, leaves, merged, buildings.result())
        return [raster.result(), *tables, write_convergence(run, merged)]
