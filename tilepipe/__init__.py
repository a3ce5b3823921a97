"""tilepipe: street, object and edge layers from city-wide rasters, tile by tile without seams.

The pipelines are functions of this package, imported on first use so that ``import tilepipe`` stays quick::

    import tilepipe
    tilepipe.streets("intensity.tif", out="run")
"""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0"

_EXPORTS = {
    "streets": "tilepipe.pipelines.streets.pipeline",
    "plan_streets": "tilepipe.pipelines.streets.pipeline",
    "StreetParameters": "tilepipe.pipelines.streets.parameters",
    "objects": "tilepipe.pipelines.objects.pipeline",
    "plan_objects": "tilepipe.pipelines.objects.pipeline",
    "ObjectParameters": "tilepipe.pipelines.objects.parameters",
    "edges": "tilepipe.pipelines.edges.pipeline",
    "plan_edges": "tilepipe.pipelines.edges.pipeline",
    "EdgeParameters": "tilepipe.pipelines.edges.parameters",
    "RunOptions": "tilepipe.engine.options",
    "open_raster": "tilepipe.io.rasters.raster",
    "as_dataarray": "tilepipe.io.rasters.raster",
    "grid_clouds": "tilepipe.pipelines.points.recipe",
    "evaluate_edge_lines": "tilepipe.evaluate.edges",
    "evaluate_lines": "tilepipe.evaluate.lines",
    "evaluate_polygons": "tilepipe.evaluate.polygons",
    "InputError": "tilepipe.errors",
    "TileError": "tilepipe.errors",
}

__all__ = ["__version__", *_EXPORTS]


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name in _EXPORTS:
        return getattr(import_module(_EXPORTS[name]), name)
    if name == "accessor":
        return import_module("tilepipe.accessor")
    raise AttributeError(f"module 'tilepipe' has no attribute '{name}'")


def __dir__() -> list[str]:
    return [*__all__, "accessor"]
