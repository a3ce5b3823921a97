"""Layers of `objects`, and the columns of its tables."""

from __future__ import annotations

from tilepipe.engine.layers import Column, DocumentLayer, RasterLayer, TableLayer

REGIONS = RasterLayer("regions.tif", "uint32", 0, "number of the region")

OBJECTS = TableLayer(
    "objects",
    "MultiPolygon",
    {
        "region_id": Column("int64", "number of the region in `regions.tif`"),
        "area_m2": Column("float64", "area of the polygon", "m²"),
        "perimeter_m": Column("float64", "length of its outline, holes included", "m"),
        "compactness": Column("float64", "4π · area / perimeter²: 1 for a disc"),
        "height_mean": Column("float64", "mean height", "m"),
        "height_min": Column("float64", "lowest pixel", "m"),
        "height_max": Column("float64", "highest pixel", "m"),
        "height_deviation": Column("float64", "standard deviation of the heights", "m"),
        "posterior_mean": Column("float64", "posterior mean of the height", "m"),
        "posterior_deviation": Column("float64", "posterior standard deviation of the height", "m"),
        "leaves": Column("int64", "squares of the quadtree that it is made of"),
        "height_above_ground": Column("float64", "mean height above the ground; empty without buildings", "m"),
        "building_probability": Column("float64", "probability of being a building's; empty without buildings"),
    },
    "region of even height; neighbours share their border exactly",
    scored=True,
)

BOUNDARIES = TableLayer(
    "boundaries",
    "LineString",
    {
        "left_id": Column("int64", "region to the left of the line, 0 = nodata or outside the raster"),
        "right_id": Column("int64", "region to its right"),
        "length_m": Column("float64", "length", "m"),
        "height_step_m": Column("float64", "posterior mean of the left less that of the right", "m"),
        "probability_one_object": Column("float64", "posterior probability that the two sides are one object"),
    },
    "border of two regions; what is one with more than `merge_probability` has merged, so that most of what remains "
    "is near 0",
)

BUILDINGS = TableLayer(
    "buildings",
    "MultiPolygon",
    {
        "building_id": Column("int64", "lowest `region_id` of its regions"),
        "probability": Column("float64", "probability of being a building: mean of its regions' by area"),
        "area_m2": Column("float64", "area of the polygon", "m²"),
        "perimeter_m": Column("float64", "length of its outline, holes included", "m"),
        "height_above_ground": Column("float64", "mean height above the ground, by area", "m"),
        "height_above_ground_max": Column("float64", "height of its highest pixel above the ground", "m"),
        "ground_height": Column("float64", "mean height of the ground, by area", "m"),
        "height_mean": Column("float64", "mean height of the roof, by area", "m"),
        "height_max": Column("float64", "highest pixel of the roof", "m"),
        "regions": Column("int64", "regions that it is made of"),
    },
    "building or block of buildings that touch, of the regions that are probably (more than 0.5) a building's",
    scored=True,
)

CONVERGENCE = DocumentLayer(
    "convergence.json", "traces, effective sample size and split-R̂ of the sampler's variances, as JSON"
)
