"""What a user would write instead of `tilepipe streets`: the same idea from off-the-shelf parts, on the whole raster.

medpy's diffusion on dask blocks, Otsu's threshold, cc3d's components, OpenCV's morphology, scikit-image's skeleton,
skan's branches; the lines go to GeoParquet.  Run as ``python -m benchmarks.streets.plain_script RASTER OUT [STEPS]``.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

SMALLEST_REGION = 600.0
"""Of a dark region that can be a street, in m²."""
LARGEST_HOLE = 36.0
"""Of a hole that is filled (a car), in m²."""
CLOSING, OPENING = 1.5, 1.0
BRANCH, PIECE = 15.0, 30.0
"""Shortest dangling branch and shortest line that stands alone, in metres."""


def main(raster: str, out: str, steps: int = 50) -> None:
    """Raster of intensity to a table of lines."""
    import geopandas as gpd
    import rasterio

    with rasterio.open(raster) as file:
        intensity, valid = file.read(1).astype(np.float32), file.read_masks(1) > 0
        transform, crs = file.transform, file.crs
    resolution = transform.a
    mask = street_mask(smoothed(filled(intensity, valid), steps), resolution)
    lines = centerlines(mask, transform, resolution)
    gpd.GeoDataFrame(geometry=lines, crs=crs).to_parquet(out)


def filled(intensity: NDArray[np.float32], valid: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Voids bridged by their surroundings."""
    from rasterio.fill import fillnodata

    return fillnodata(intensity, valid, max_search_distance=20)


def smoothed(intensity: NDArray[np.float32], steps: int) -> NDArray[np.float32]:
    """Perona–Malik diffusion in blocks of 1024 pixels on all cores."""
    import dask.array as da
    from medpy.filter.smoothing import anisotropic_diffusion

    blocks = da.from_array(intensity, chunks=1024)
    smooth = blocks.map_overlap(
        anisotropic_diffusion, depth=steps, boundary="none", dtype=np.float32, meta=np.empty((0, 0), np.float32),
        niter=steps, kappa=30, gamma=0.15, option=1,
    )  # fmt: skip
    return np.asarray(smooth.compute(), np.float32)


def street_mask(smooth: NDArray[np.float32], resolution: float) -> NDArray[np.bool_]:
    """Large dark regions, closed, without small holes, opened."""
    import cc3d
    import cv2
    from skimage.filters import threshold_otsu

    area = resolution**2
    dark = smooth < threshold_otsu(smooth)
    large = cc3d.dust(dark, threshold=int(SMALLEST_REGION / area), connectivity=4).astype(np.uint8)
    closed = cv2.morphologyEx(large, cv2.MORPH_CLOSE, _disc(CLOSING / resolution))
    whole = 1 - cc3d.dust(closed == 0, threshold=int(LARGEST_HOLE / area), connectivity=8).astype(np.uint8)
    return cv2.morphologyEx(whole, cv2.MORPH_OPEN, _disc(OPENING / resolution)) > 0


def _disc(radius: float) -> NDArray[np.uint8]:
    import cv2

    side = 2 * round(radius) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))


def centerlines(mask: NDArray[np.bool_], transform: Any, resolution: float) -> list[Any]:
    """Skeleton, pruned once, as lines in the coordinates of the raster."""
    import shapely
    from skan import Skeleton, summarize
    from skimage.morphology import skeletonize

    graph = Skeleton(skeletonize(mask))
    branches = summarize(graph, separator="_")
    short = (branches.branch_type == 1) & (branches.branch_distance * resolution < BRANCH)
    short |= (branches.branch_type == 0) & (branches.branch_distance * resolution < PIECE)
    pruned = graph.prune_paths(list(branches.index[short]))
    lines = []
    for number in range(pruned.n_paths):
        row, column = (pruned.path_coordinates(number) + 0.5).T
        lines.append(shapely.linestrings(np.column_stack(transform * (column, row))))
    return lines


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], *(int(argument) for argument in sys.argv[3:]))
