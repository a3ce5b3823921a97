"""Options that several commands of the command line share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

Rasters = Annotated[
    list[str],
    typer.Argument(metavar="RASTER", help="Rasters (GeoTIFF, COG, VRT, Zarr), paths or URLs; several are one mosaic."),
]
RunFolder = Annotated[Path | None, typer.Option(help="Folder of the run; not needed with --plan.")]
Tile = Annotated[int, typer.Option(help="Tile size in pixels.")]
Workers = Annotated[
    int | None, typer.Option(help="Threads or processes; by default all cores, or as many as --memory holds.")
]
ExecutorName = Annotated[str, typer.Option("--executor", help="threads, processes, or tcp://host:port of a cluster.")]
Backend = Annotated[str, typer.Option(help="auto, numpy or cupy.")]
Memory = Annotated[str, typer.Option(help="Most memory to use, checked before work starts.")]
Seed = Annotated[int, typer.Option(help="Seed of random draws.")]
Crs = Annotated[str | None, typer.Option(help="EPSG:n for inputs that name no CRS; none may name another.")]
Format = Annotated[str, typer.Option("--format", help="parquet, gpkg, fgb or geojson.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace a finished run.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress, only warnings and errors.")]
Band = Annotated[int | None, typer.Option(help="Band to use where a raster has several.")]
Assignments = Annotated[list[str] | None, typer.Option("--set", help="A parameter as name=value; repeatable.")]
PlanOnly = Annotated[bool, typer.Option("--plan", help="Show tiles, passes, halos and memory, and stop.")]
