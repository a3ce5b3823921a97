"""tilepipe: street, object and edge layers from city-wide rasters, tile by tile without seams.

The pipelines are functions of this package, imported on first use so that ``import tilepipe`` stays quick::

    import tilepipe
    tilepipe.streets("intensity.tif", out="run")
"""

from __future__ import annotations

from typing import Any

__version__ = "0.1.0"

_EXPORTS = {
    "streets": "tilepipe.streets",
    "plan_streets": "tilepipe.streets",
    "StreetParameters": "tilepipe.street_parameters",
    "RunOptions": "tilepipe.options",
    "open_raster": "tilepipe.raster",
    "as_dataarray": "tilepipe.raster",
    "grid_clouds": "tilepipe.gridding",
    "evaluate_lines": "tilepipe.evaluate",
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
