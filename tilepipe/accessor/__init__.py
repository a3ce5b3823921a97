"""Lazy operators on xarray arrays: ``import tilepipe.accessor`` and then ``array.tilepipe.diffuse(…)``.

Every operator keeps chunks, coordinates, attributes and CRS, computes nothing by itself when the array is lazy (over
dask), and gives the same values whatever the chunks are: each chunk is computed with its halo.  The result is named
after the operator.  Greys and lengths of pixels are those of the kernels; nodata is NaN or the array's own nodata
value.  A packed array (``scale_factor``, ``add_offset``) counts as what it means, and no result carries its scale; what
lies below a pixel is in the next row, whatever the order of the dims.
"""

from __future__ import annotations

from typing import Any

import xarray as xr

from tilepipe.accessor.edges import EdgeOperators
from tilepipe.accessor.objects import ObjectOperators
from tilepipe.accessor.streets import StreetOperators
from tilepipe.pipelines import registry

__all__ = ["TilepipeAccessor"]


@xr.register_dataarray_accessor("tilepipe")
class TilepipeAccessor(StreetOperators, ObjectOperators, EdgeOperators):
    """Operators of tilepipe on a raster with two dimensions (rows, columns)."""

    def __getattr__(self, name: str) -> Any:
        """An operator that the pipeline of another package brings."""
        if not name.startswith("_"):
            for pipeline in registry.names()[len(registry.OWN) :]:
                operators = registry.pipeline(pipeline).operators
                if operators and hasattr(registry.part(operators), name):
                    return getattr(registry.part(operators)(self._array), name)
        raise AttributeError(f"tilepipe has no operator '{name}'")
