"""Tables of the columns of every layer.

The names are those that the pipelines write; what they mean is said here.
"""

from __future__ import annotations

from docs.from_code.markdown import table
from tilepipe.pipelines.edges.tables import EDGE_COLUMNS, NEVATIA_BABU_COLUMNS
from tilepipe.pipelines.objects.building_table import BUILDING_COLUMNS
from tilepipe.pipelines.objects.pass_borders import BOUNDARY_COLUMNS, OBJECT_COLUMNS
from tilepipe.pipelines.streets.tables import COLUMNS

TABLES: dict[str, dict[str, str]] = {
    "centerlines": COLUMNS,
    "skeleton": COLUMNS,
    "objects": OBJECT_COLUMNS,
    "boundaries": BOUNDARY_COLUMNS,
    "buildings": BUILDING_COLUMNS,
    "edges": EDGE_COLUMNS,
    "nevatia_babu": NEVATIA_BABU_COLUMNS,
}
"""Types of the columns of each table, by name."""

_STREETS = {
    "line_id": ("", "number of the line: 1, 2, …"),
    "from_node": ("", "node where the line begins; lines that meet share the number"),
    "to_node": ("", "node where the line ends"),
    "length_m": ("m", "length"),
    "mean_width_m": ("m", "mean width of the street along the line"),
    "start_width_m": ("m", "mean width near its beginning"),
    "end_width_m": ("m", "mean width near its end"),
    "response": ("grey/pixel²", "how clear the ridge is: second derivative across it (not in the skeleton)"),
    "contrast": ("grey, 0–255", "how much darker the street is than what lies beside it"),
    "position_standard_error_m": ("m", "error across the line that the noise lets expect (not in the skeleton)"),
    "region_id": ("", "region of `streets.tif` that most of the line lies in, 0 for none"),
}
_SHAPE = {
    "length_m": ("m", "length"),
    "straightness": ("", "1 where all parts point the same way, 0 where they point everywhere"),
    "sinuosity": ("", "length over the distance of the ends; empty for closed lines"),
}
MEANINGS: dict[str, dict[str, tuple[str, str]]] = {
    "centerlines": _STREETS,
    "skeleton": _STREETS,
    "objects": {
        "region_id": ("", "number of the region in `regions.tif`"),
        "area_m2": ("m²", "area of the polygon"),
        "perimeter_m": ("m", "length of its outer and inner borders"),
        "compactness": ("", "1 for a disc, less for long or ragged shapes"),
        "height_mean": ("m", "mean height of its pixels"),
        "height_min": ("m", "lowest height of its pixels"),
        "height_max": ("m", "highest height of its pixels"),
        "height_deviation": ("m", "standard deviation of the heights of its pixels"),
        "posterior_mean": ("m", "posterior mean of the height of the region"),
        "posterior_deviation": ("m", "posterior standard deviation of that height"),
        "leaves": ("", "squares of the quadtree that it is made of"),
        "height_above_ground": ("m", "mean height above the estimated ground; empty without buildings"),
        "building_probability": ("", "probability that it is part of a building; empty without buildings"),
    },
    "boundaries": {
        "left_id": ("", "region on the left of the line, 0 for none (nodata or outside)"),
        "right_id": ("", "region on the right of the line, 0 for none"),
        "length_m": ("m", "length"),
        "height_step_m": ("m", "posterior mean of the left less that of the right"),
        "probability_one_object": ("", "posterior probability that the two sides are one object"),
    },
    "buildings": {
        "building_id": ("", "number of the building: the lowest `region_id` of its regions"),
        "probability": ("", "mean probability of its regions, by area"),
        "area_m2": ("m²", "area of the polygon"),
        "perimeter_m": ("m", "length of its outer and inner borders"),
        "height_above_ground": ("m", "mean height of the roof above the estimated ground"),
        "height_above_ground_max": ("m", "highest height of its regions above the ground"),
        "ground_height": ("m", "height of the estimated ground"),
        "height_mean": ("m", "mean height of the roof"),
        "height_max": ("m", "highest height of the roof"),
        "regions": ("", "number of regions that it is made of"),
    },
    "edges": {
        "line_id": ("", "number of the line: 1, 2, …"),
        "contrast": ("grey, 0–255", "mean difference of the two sides"),
        **_SHAPE,
        "street_border": (
            "",
            "whether the line may border a street: three tenths of it or more have a parallel line opposite, in a "
            "strip of even width, twice as long as wide",
        ),
        "street_width_m": ("m", "distance of the two, empty where there is none"),
        "street_partner": ("", "`line_id` of the line opposite, 0 for none"),
        "street_share": ("", "share of the line along that strip"),
    },
    "nevatia_babu": {
        "line_id": ("", "number of the line: 1, 2, …"),
        "contrast": ("grey, 0–255", "mean step across the line"),
        **_SHAPE,
        "stage": ("", "stage of the tracing that found it: 1 = from open ends, 2 = branches, 3 = rings and the rest"),
    },
}
"""Unit and meaning of each column."""


def column_table(name: str) -> str:
    """The columns of one table: name, type, unit, meaning."""
    rows = [(f"`{column}`", f"{kind}", *MEANINGS[name][column]) for column, kind in TABLES[name].items()]
    return table(("column", "type", "unit", "meaning"), rows)
