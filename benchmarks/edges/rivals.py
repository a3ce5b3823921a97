"""What a user would write instead of `tilepipe edges`: Canny and contours on the whole image in memory.

With OpenCV: `Canny`, `findContours`; with scikit-image: `canny`, `find_contours`.  Both write the mask of edges as
GeoTIFF and the lines as GeoParquet.  Run as ``python -m benchmarks.edges.rivals RASTER OUT opencv``; the seconds of
each step go to ``OUT/timings.json``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.edges.lines import canny_opencv, canny_skimage
from benchmarks.objects.rivals import timed

MASK = "edges.tif"
LINES = "edges.parquet"
LUMINANCE = (0.299, 0.587, 0.114)

Lines = list[NDArray[np.float64]]


def main(raster: str, out: str, way: str) -> None:
    """Photograph to a mask of edges and a table of lines."""
    import rasterio

    folder, seconds = Path(out), dict[str, float]()
    folder.mkdir(parents=True, exist_ok=True)
    with timed(seconds, "read"), rasterio.open(raster) as file:
        image = grey_of(file.read())
        profile = {"crs": file.crs, "transform": file.transform}
    with timed(seconds, "Canny"):
        mask = {"opencv": canny_opencv, "skimage": canny_skimage}[way](image)().astype(np.uint8)
    with timed(seconds, "contours"):
        lines = {"opencv": contours_opencv, "skimage": contours_skimage}[way](mask)
    with timed(seconds, "raster"):
        _write_mask(folder / MASK, mask, profile)
    with timed(seconds, "table"):
        _write_lines(folder / LINES, lines, profile)
    (folder / "timings.json").write_text(json.dumps(seconds))


def grey_of(bands: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Luminance of three bands, or the only band."""
    if len(bands) < 3:
        return bands[0]
    weighted = sum(np.float32(weight) * band for weight, band in zip(LUMINANCE, bands, strict=False))
    return np.rint(weighted).astype(np.uint8)


def contours_opencv(mask: NDArray[np.uint8]) -> Lines:
    """Outlines of the edges through centres of pixels, straight runs shortened to their ends: (row, column)."""
    import cv2

    found, _ = cv2.findContours(mask, cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE)
    return [line[:, 0, ::-1] + 0.5 for line in found if len(line) > 1]


def contours_skimage(mask: NDArray[np.uint8]) -> Lines:
    """Outlines of the edges half way between centres of pixels: (row, column)."""
    from skimage.measure import find_contours

    return [line + 0.5 for line in find_contours(mask > 0, 0.5, fully_connected="high")]


def _write_mask(path: Path, mask: NDArray[np.uint8], profile: dict[str, Any]) -> None:
    import rasterio

    rows, columns = mask.shape
    options = {"tiled": True, "compress": "deflate", "zlevel": 1, "num_threads": "all_cpus"}
    options |= {"driver": "GTiff", "dtype": "uint8", "count": 1, "height": rows, "width": columns}
    with rasterio.open(path, "w", **options, **profile) as file:
        file.write((mask > 0).astype(np.uint8), 1)


def _write_lines(path: Path, lines: Lines, profile: dict[str, Any]) -> None:
    import geopandas as gpd
    import shapely

    row, column = np.concatenate(lines or [np.empty((0, 2))]).T
    line = np.repeat(np.arange(len(lines)), [len(each) for each in lines])
    geometry = shapely.linestrings(np.column_stack(profile["transform"] * (column, row)), indices=line)
    gpd.GeoDataFrame({"length": shapely.length(geometry)}, geometry=geometry, crs=profile["crs"]).to_parquet(path)


if __name__ == "__main__":
    main(*sys.argv[1:])
