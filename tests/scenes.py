"""Small drawn street scenes and the runs on them, for the tests of the laws."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.options import RunOptions
from tilepipe.pipelines.streets.pipeline import streets

LAYERS = ("streets.tif", "centerlines.parquet", "skeleton.parquet")

SMALL: dict[str, Any] = {
    "diffusion_steps": 4,
    "gradient_sigma": 1.0,
    "minimum_size": 20,
    "minimum_contour": 30,
    "minimum_elongation": 2,
    "line_width": 8,
    "minimum_street_width": 3,
    "maximum_width": 16,
    "minimum_length": 8,
    "minimum_branch": 6,
    "maximum_gap": 6,
    "void_reach": 1.0,
}
"""Parameters that suit scenes of about 100 pixels of 1 m."""

STREET, GROUND = 40.0, 160.0


def draw(shape: tuple[int, int], mask: NDArray[np.bool_], seed: int = 0) -> NDArray[np.float32]:
    """Dark streets on bright ground, with noise."""
    rng = np.random.default_rng(seed)
    return (np.where(mask, STREET, GROUND) + rng.normal(0, 6, shape)).astype(np.float32)


def band(shape: tuple[int, int], a: tuple[float, float], b: tuple[float, float], width: float) -> NDArray[np.bool_]:
    """Pixels within half a width of the segment from a to b, both (row, column)."""
    row, column = np.mgrid[: shape[0], : shape[1]].astype(float)
    along = np.array(b) - np.array(a)
    t = np.clip(((row - a[0]) * along[0] + (column - a[1]) * along[1]) / (along @ along), 0, 1)
    return np.hypot(row - a[0] - t * along[0], column - a[1] - t * along[1]) <= width / 2


def ring(shape: tuple[int, int], centre: tuple[float, float], radius: float, width: float) -> NDArray[np.bool_]:
    """Pixels of a ring."""
    row, column = np.mgrid[: shape[0], : shape[1]].astype(float)
    return np.abs(np.hypot(row - centre[0], column - centre[1]) - radius) <= width / 2


def write_raster(
    path: Path,
    values: NDArray[Any],
    *,
    crs: str | None = "EPSG:32633",
    pixel: float = 1.0,
    origin: tuple[float, float] = (500000.0, 5000000.0),
    nodata: float | None = None,
    transform: Any = None,
) -> Path:
    """A GeoTIFF of one band."""
    import rasterio
    from rasterio.transform import from_origin

    transform = transform or from_origin(*origin, pixel, pixel)
    rows, columns = values.shape
    with rasterio.open(
        path,
        "w",
        driver="GTiff",
        width=columns,
        height=rows,
        count=1,
        dtype=values.dtype,
        crs=crs,
        transform=transform,
        nodata=nodata,
    ) as dataset:
        dataset.write(values, 1)
    return path


def run_streets(
    raster: Any, out: Path, tile: int, *, workers: int = 1, executor: str = "threads", **params: Any
) -> Path:
    """Run the pipeline with the small parameters."""
    options = RunOptions(tile=tile, workers=workers, executor=executor)
    streets(raster, out=out, params=SMALL | params, options=options)
    return out
