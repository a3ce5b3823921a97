"""Layers of `edges`, and the columns of its tables."""

from __future__ import annotations

from tilepipe.engine.layers import Column, DocumentLayer, RasterLayer, TableLayer

NODATA = 255
"""Level and lines of a pixel without data."""

_SHAPE = {
    "length_m": Column("float64", "length", "m"),
    "straightness": Column("float64", "1 where all parts point the same way, 0 where they point everywhere"),
    "sinuosity": Column("float64", "length over the distance of the ends; empty for closed lines"),
}

SEGMENTS = RasterLayer("segments.tif", "uint8", NODATA, "level of grey, 0 = darkest")
LINES = RasterLayer("lines.tif", "uint8", NODATA, "line field: 1 = an edge below the pixel, 2 = to its right, 3 = both")

EDGES = TableLayer(
    "edges",
    "LineString",
    {
        "line_id": Column("int64", "number of the line: 1, 2, …"),
        "contrast": Column("float64", "mean difference of the two sides", "grey, 0–255"),
        **_SHAPE,
        "street_border": Column(
            "bool",
            "whether the line may border a street: three tenths of it or more have a parallel line opposite, in a "
            "strip of even width, twice as long as wide",
        ),
        "street_width_m": Column("float64", "distance of the two, empty where there is none", "m"),
        "street_partner": Column("int64", "`line_id` of the line opposite, 0 for none"),
        "street_share": Column("float64", "share of the line along that strip"),
    },
    "line of the line field, cut where three edges meet, smoothed within half a pixel",
    scored=True,
)

NEVATIA_BABU = TableLayer(
    "nevatia_babu",
    "LineString",
    {
        "line_id": Column("int64", "number of the line: 1, 2, …"),
        "contrast": Column("float64", "mean step of grey across the line", "grey of the input"),
        **_SHAPE,
        "stage": Column(
            "int64", "of the tracing that found the line: 1 = from open ends, 2 = branches, 3 = rings and the rest"
        ),
    },
    "edge of the classical method, a chain of straight pieces",
)

IMAGE_SUMMARY = DocumentLayer(
    "edges.json",
    "what the grey values are, the levels, the energy, and how many sites the cap on rounds has left unfinished",
)
