"""Lazy operators of the pipeline `spots` on xarray arrays."""

from __future__ import annotations

import numpy as np
import xarray as xr

from tilepipe.accessor.blocks import BlockOperators


class SpotOperators(BlockOperators):
    """``array.tilepipe.bright(threshold=…)``, once ``tilepipe.accessor`` is imported."""

    def bright(self, *, threshold: float = 200.0) -> xr.DataArray:
        """Whether values are bright; nodata is not."""
        return self.map_blocks(
            "bright", lambda block, tile: block[tile.core_in_padded.slices] >= threshold, 0, np.bool_
        )
