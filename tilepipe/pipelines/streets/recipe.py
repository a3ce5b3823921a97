"""The recipe of `streets` (Mendes & Dal Poz 2012): what a run does, in the order of the paper's flow chart."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from tilepipe.engine.work import Work
from tilepipe.pipelines.streets.pass_levels import LEVELS, CountContext, grey_scale
from tilepipe.pipelines.streets.pass_lines import LINES, LineContext, published_regions
from tilepipe.pipelines.streets.pass_responses import find_thresholds
from tilepipe.pipelines.streets.pass_segment import SEGMENT, SegmentContext
from tilepipe.pipelines.streets.reconcile_regions import find_regions
from tilepipe.pipelines.streets.tables import write_lines


def recipe(run: Work) -> list[Path]:
    """Grey scale, regions, thresholds, lines: intensity in, street regions and centerlines out."""
    counted = run.over_tiles(LEVELS, CountContext(run.raster, run.backend))
    scale = grey_scale(counted.each(), run.parameters, run.raster.names[0])
    regions = find_regions(run, run.over_tiles(SEGMENT, SegmentContext.of(run, scale)))
    thresholds = find_thresholds(run, scale, regions)
    lines = LineContext.of(run, scale, regions, thresholds.low)
    # the raster needs the regions only, so it is written beside the pass
    with run.beside(run.write_raster, "streets.tif", partial(published_regions, lines)) as raster:
        fragments = run.over_tiles(LINES, lines)
        return [raster.result(), *write_lines(run, fragments, thresholds)]
