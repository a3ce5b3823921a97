"""The recipe of `edges` (Barbosa 1994): what a run does, in the order of the thesis' flow chart."""

from __future__ import annotations

from pathlib import Path

from tilepipe.engine.work import Work
from tilepipe.pipelines.edges.pass_bands import grey_photograph
from tilepipe.pipelines.edges.pass_fields import FIELDS, FieldContext, write_fields
from tilepipe.pipelines.edges.pass_levels import LEVELS, CountContext, find_levels
from tilepipe.pipelines.edges.summary import write_summary
from tilepipe.pipelines.edges.tables import write_tables


def recipe(run: Work) -> list[Path]:
    """Grey values, levels, both fields, lines: a photograph in, its segmentation and its edges out."""
    photograph = grey_photograph(run)
    counted = run.over_tiles(LEVELS, CountContext(photograph, run.parameters.nevatia_babu, run.backend))
    levels, threshold = find_levels(run, counted)
    context = FieldContext.of(run, photograph, levels, threshold)
    fields = run.over_tiles(FIELDS, context)
    with run.beside(write_fields, run, context) as rasters:
        tables = write_tables(run, fields)
        return [*rasters.result(), *tables, write_summary(run, photograph, levels, fields)]
