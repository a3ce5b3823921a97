"""How well a partition of the plane holds true buildings, and how well chosen parts of it are buildings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.objects.scenes import ObjectScene
from tilepipe.evaluate.polygon_layers import common_areas
from tilepipe.evaluate.polygons import AreaScore, evaluate_polygons
from tilepipe_kernels.heights.ground import ground_height

OVERLAP = 0.5
"""Share of an object, or of a block, that counts as found."""
SMALLEST_BLOCK = 50.0
"""Of a block that is scored, in m²: the ISPRS benchmark's."""
BOUNDARY = 1.0
"""Metres within which a boundary is found."""
BUILDING_HEIGHT = 2.5
"""Metres above ground from which the plain rule takes an object for a building."""

Geometries = NDArray[np.object_]


@dataclass(frozen=True)
class PartitionScore:
    """How well the objects of a partition make up the true blocks; shares are 0 to 1.

    Attributes
    ----------
    blocks
        Blocks scored: true buildings that touch are one.
    found
        Share of the blocks whose best union has an IoU of at least `OVERLAP`.
    iou
        IoU of a block with its best union, the objects that lie in it by more than half; mean over the blocks.
    objects_per_block
        Mean number of objects in a best union: over-segmentation, 1 is best.
    under_segmentation
        Σ over blocks and objects that meet of the smaller of the object's areas inside and outside the block, per
        area of the blocks (Neubert & Protzel 2012, Superpixel benchmark and comparison, eq. 5); 0 is best.
    union
        The best unions of all blocks, dissolved, against the blocks.
    """

    blocks: int
    found: float
    iou: float
    objects_per_block: float
    under_segmentation: float
    union: AreaScore


def blocks_of(scene: ObjectScene) -> Geometries:
    """True buildings inside the scene's area, those that touch made one, without small ones."""
    import shapely

    truth = shapely.make_valid(scene.truth)
    whole = shapely.union_all(truth)
    parts: Geometries = shapely.get_parts(whole if scene.area is None else shapely.intersection(whole, scene.area))
    polygonal = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
    kept: Geometries = parts[polygonal & (shapely.area(parts) >= SMALLEST_BLOCK)]
    return kept


def score_partition(objects: Geometries, scene: ObjectScene, blocks: Geometries) -> PartitionScore:
    """Score objects that do not overlap against the blocks of `blocks_of`."""
    import shapely

    if scene.area is not None:
        objects = _within(objects, scene.area)
    pair, common = _pairs(objects, blocks)
    size, block_size = shapely.area(objects)[pair[0]], shapely.area(blocks)
    chosen = common > OVERLAP * size
    inside, taken, number = (
        np.bincount(pair[1, chosen], weights[chosen], len(blocks)) for weights in (common, size, np.ones(len(common)))
    )
    iou = inside / (block_size + taken - inside)
    return PartitionScore(
        blocks=len(blocks),
        found=float((iou >= OVERLAP).mean()),
        iou=float(iou.mean()),
        objects_per_block=float(number[number > 0].mean()) if chosen.any() else math.nan,
        under_segmentation=float(np.minimum(common, size - common).clip(0).sum() / block_size.sum()),
        union=score_buildings(objects[pair[0, chosen]], blocks, scene),
    )


def score_buildings(polygons: Geometries, truth: Geometries, scene: ObjectScene) -> AreaScore:
    """Score polygons taken for buildings, by the functions of `tilepipe evaluate --dissolve`."""
    return evaluate_polygons(
        polygons, truth, area=scene.area, dissolve=True, overlap=OVERLAP, minimum_area=SMALLEST_BLOCK, cutoff=BOUNDARY
    )


def _within(objects: Geometries, area: object) -> Geometries:
    import shapely

    shapely.prepare(area)
    cut = ~shapely.covers(area, objects)
    objects = objects.copy()
    objects[cut] = shapely.intersection(objects[cut], area)
    left: Geometries = objects[shapely.area(objects) > 0]
    return left


def _pairs(objects: Geometries, blocks: Geometries) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Indices (2, n) of objects and blocks that meet, and the area they share."""
    import shapely

    # multipolygons come to pieces, and a pair may meet in several
    parts, owner = shapely.get_parts(objects, return_index=True)
    polygonal = shapely.get_type_id(parts) == shapely.GeometryType.POLYGON
    i, j, common = common_areas(parts[polygonal], blocks)
    keys, place = np.unique(owner[polygonal][i] * len(blocks) + j, return_inverse=True)
    total: NDArray[np.float64] = np.bincount(place, common, len(keys)).astype(np.float64)
    keys, total = keys[total > 0], total[total > 0]
    return np.stack(np.divmod(keys, len(blocks))), total


def high_regions(raster: Path, regions: Path) -> NDArray[np.int64]:
    """Ids of the regions whose mean height above ground is that of a building or a tree."""
    import rasterio

    with rasterio.open(raster) as file:
        height, valid = file.read(1).astype(np.float32), file.read_masks(1) > 0
        height[~valid] = np.nan
        above = np.nan_to_num(height - ground_height(height, resolution=file.transform.a))
    with rasterio.open(regions) as file:
        labels = file.read(1).ravel()
    count, total = np.bincount(labels), np.bincount(labels, weights=above.ravel())
    high = total > BUILDING_HEIGHT * count
    high[0] = False
    return np.flatnonzero(high)
