"""Layers of `streets`, and the columns of its tables."""

from __future__ import annotations

from tilepipe.engine.layers import Column, RasterLayer, TableLayer

NODATA = 4294967295
"""Region id of nodata pixels."""

_COLUMNS = {
    "line_id": Column("int64", "number of the line: 1, 2, …"),
    "from_node": Column("int64", "node where the line begins; lines that meet share the number"),
    "to_node": Column("int64", "node where the line ends"),
    "length_m": Column("float64", "length", "m"),
    "mean_width_m": Column("float64", "mean width of the street along the line", "m"),
    "start_width_m": Column("float64", "mean width near its beginning", "m"),
    "end_width_m": Column("float64", "mean width near its end", "m"),
    "response": Column(
        "float64",
        "how clear the ridge is: second derivative across it; empty in the skeleton",
        "grey/pixel²",
    ),
    "contrast": Column("float64", "how much darker the street is than what lies beside it", "grey, 0–255"),
    "position_standard_error_m": Column(
        "float64", "error across the line that the noise lets expect; empty in the skeleton", "m"
    ),
    "region_id": Column("int64", "region of `streets.tif` that most of the line lies in, 0 for none"),
}

REGIONS = RasterLayer("streets.tif", "uint32", NODATA, "number of the street region, 0 = no street")
CENTERLINES = TableLayer(
    "centerlines",
    "LineString",
    _COLUMNS,
    "centerline between two nodes, as a ridge line of the intensity with sub-pixel precision",
    scored=True,
)
SKELETON = TableLayer(
    "skeleton",
    "LineString",
    _COLUMNS,
    "centerline between two nodes, as the skeleton of the regions: fewer gaps, a little less smooth",
)
