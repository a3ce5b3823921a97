"""What a user would write instead of `tilepipe objects`: off-the-shelf parts on the whole raster.

A 3 × 3 median against noise, cc3d's components of pixels that differ by at most half a metre from a neighbour, small
ones removed, polygons by rasterio; the same layers are written.  Run as ``python -m benchmarks.objects.rivals RASTER
OUT``; the seconds of each step go to ``OUT/timings.json``.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST_STEP = 0.5
"""Most that neighbours of one object differ by, in metres: the merge height of `tilepipe objects`."""
SMALLEST_AREA = 4.0
"""In m², the minimum area of `tilepipe objects`."""


def main(raster: str, out: str) -> None:
    """Raster of heights to labels and polygons."""
    import rasterio

    folder, seconds = Path(out), dict[str, float]()
    folder.mkdir(parents=True, exist_ok=True)
    with timed(seconds, "read"), rasterio.open(raster) as file:
        height, valid = file.read(1).astype(np.float32), file.read_masks(1) > 0
        profile = {"crs": file.crs, "transform": file.transform}
    with timed(seconds, "median"):
        height = smoothed(height, valid)
    with timed(seconds, "components"):
        labels = components(height, valid, profile["transform"].a)
    with timed(seconds, "raster"):
        _write_labels(folder / "regions.tif", labels, profile)
    with timed(seconds, "polygons"):
        ids, polygons = polygons_of(labels, profile["transform"])
    with timed(seconds, "table"):
        _write_table(folder / "objects.parquet", ids, polygons, labels, height, profile["crs"])
    (folder / "timings.json").write_text(json.dumps(seconds))


@contextmanager
def timed(seconds: dict[str, float], step: str) -> Iterator[None]:
    """Note the seconds of a step."""
    start = time.perf_counter()
    yield
    seconds[step] = time.perf_counter() - start


def smoothed(height: NDArray[np.float32], valid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Median of 3 × 3 pixels; voids count as low, so that they do not spread."""
    import cv2

    lowest = height[valid].min() if valid.any() else np.float32(0)
    return cv2.medianBlur(np.where(valid, height, lowest), 3)


def components(height: NDArray[np.float32], valid: NDArray[np.bool_], resolution: float) -> NDArray[np.uint32]:
    """Number of each pixel's object; 0 = nodata or too small."""
    import cc3d

    # cc3d takes the value 0 for background
    shifted = np.where(valid, height - height.min() + 1, 0).astype(np.float32)
    labels = cc3d.connected_components(shifted, connectivity=4, delta=LARGEST_STEP)
    least = round(SMALLEST_AREA / resolution**2)
    kept = cc3d.dust(labels, threshold=least, connectivity=4, precomputed_ccl=True)
    return kept.astype(np.uint32)


def polygons_of(labels: NDArray[np.uint32], transform: Any) -> tuple[NDArray[np.int64], NDArray[np.object_]]:
    """Ids and polygons of the objects, along the pixels' sides."""
    from rasterio.features import shapes
    from shapely.geometry import shape

    signed = labels.astype(np.int32)
    found = [
        (number, shape(geometry))
        for geometry, number in shapes(signed, mask=signed > 0, connectivity=4, transform=transform)
    ]
    ids, polygons = np.empty(len(found), np.int64), np.empty(len(found), object)
    for place, (number, polygon) in enumerate(found):
        ids[place], polygons[place] = number, polygon
    return ids, polygons


def _write_labels(path: Path, labels: NDArray[np.uint32], profile: dict[str, Any]) -> None:
    import rasterio

    rows, columns = labels.shape
    options = {"tiled": True, "compress": "deflate", "predictor": 2, "zlevel": 1, "num_threads": "all_cpus"}
    options |= {"driver": "GTiff", "dtype": "uint32", "nodata": 0, "count": 1, "height": rows, "width": columns}
    with rasterio.open(path, "w", **options, **profile) as file:
        file.write(labels, 1)


def _write_table(
    path: Path,
    ids: NDArray[np.int64],
    polygons: NDArray[np.object_],
    labels: NDArray[np.uint32],
    height: NDArray[np.float32],
    crs: Any,
) -> None:
    import geopandas as gpd
    import shapely

    flat = labels.ravel()
    count = np.maximum(np.bincount(flat), 1)
    mean = np.bincount(flat, weights=height.ravel()) / count
    columns = {"region_id": ids, "area_m2": shapely.area(polygons), "height_mean": mean[ids]}
    gpd.GeoDataFrame(columns, geometry=polygons, crs=crs).to_parquet(path)


if __name__ == "__main__":
    main(*sys.argv[1:])
