"""tilepipe: street, object and edge layers from city-wide rasters, tile by tile without seams.

The pipelines are functions of this package, imported on first use so that ``import tilepipe`` stays quick::

    import tilepipe
    tilepipe.streets("intensity.tif", out="run")
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

__version__ = "0.1.0"

_EXPORTS = {
    "streets": "tilepipe.streets",
    "plan_streets": "tilepipe.streets",
    "StreetParameters": "tilepipe.street_parameters",
    "objects": "tilepipe.objects",
    "plan_objects": "tilepipe.objects",
    "ObjectParameters": "tilepipe.object_parameters",
    "edges": "tilepipe.edges",
    "plan_edges": "tilepipe.edges",
    "EdgeParameters": "tilepipe.edge_parameters",
    "RunOptions": "tilepipe.options",
    "open_raster": "tilepipe.raster",
    "as_dataarray": "tilepipe.raster",
    "grid_clouds": "tilepipe.gridding",
    "evaluate_edge_lines": "tilepipe.evaluate_edges",
    "evaluate_lines": "tilepipe.evaluate",
    "evaluate_polygons": "tilepipe.evaluate_areas",
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


class _Package(ModuleType):
    """The package; the import of the module `tilepipe.streets` must not hide the function `tilepipe.streets`."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _EXPORTS and isinstance(value, ModuleType):
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
