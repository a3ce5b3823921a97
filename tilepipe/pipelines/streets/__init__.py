"""Street centerlines from lidar intensity (Mendes & Dal Poz 2012).

Here stands what the command line shows of the pipeline without importing it.
"""

from __future__ import annotations

from tilepipe.engine.inputs import Input

SUMMARY = "Street centerlines from lidar intensity (dark streets), by ridge lines and by skeleton."

INPUTS = (
    Input("heights", "height", "Height raster (DSM) on the same grid, to leave out trees and roofs.", heights=True),
)
