"""A small fabricated run of streets, and the colours of its pictures."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import rasterio
import shapely
from matplotlib.colors import to_rgb
from PIL import Image
from rasterio.transform import from_origin

from tilepipe.io.rasters.cog import cog_from_tiled
from tilepipe.io.vectors.formats import write_table
from tilepipe.io.vectors.gdal_tables import SUFFIX

CRS = "EPSG:2994"
LEFT, TOP, PIXEL = 6e5, 8e5, 2.0


def make_run(folder: Path, rows: int = 120, columns: int = 200, format: str = "parquet") -> Path:
    """A run with three streets that meet in the middle of the raster."""
    folder.mkdir()
    middle = (LEFT + columns * PIXEL / 2, TOP - rows * PIXEL / 2)
    ends = [(LEFT, middle[1]), (LEFT + columns * PIXEL, middle[1]), (middle[0], TOP)]
    lines = [shapely.LineString([middle, end]) for end in ends]
    streets = np.zeros((rows, columns), np.uint32)
    streets[rows // 2 - 4 : rows // 2 + 4] = 7
    streets[: rows // 2, columns // 2 - 4 : columns // 2 + 4] = 7
    intensity = np.where(streets > 0, 40, 180).astype(np.uint8)
    intensity[:5, :5] = 0
    transform = from_origin(LEFT, TOP, PIXEL, PIXEL)
    for name, values in [("labels.tif", streets), ("intensity.tif", intensity)]:
        profile = {
            "driver": "GTiff",
            "height": rows,
            "width": columns,
            "count": 1,
            "dtype": values.dtype,
            "nodata": 0,
        }
        with rasterio.open(folder / name, "w", **profile, crs=CRS, transform=transform) as file:
            file.write(values, 1)
    cog_from_tiled(folder / "labels.tif", folder / "streets.tif")
    facts = {"line_id": np.arange(3), "from_node": np.zeros(3, int), "to_node": np.arange(1, 4)}
    facts |= {"length_m": shapely.length(lines) * 0.3048, "mean_width_m": np.array([4.9, 5.0, np.nan])}
    for name in ("centerlines", "skeleton"):
        write_table(folder / f"{name}{SUFFIX[format]}", facts, lines, CRS, format)
    (folder / "run.toml").write_text(
        '[inputs]\nrasters = ["intensity.tif", "lost.tif"]\n[parameters]\nname = "<b>bold</b>"\nsigma = 1.5\n'
    )
    (folder / "timings.json").write_text(json.dumps({"diffuse": 1.25, "grow": 0.5}))
    return folder


def pixels_of(path: Path, colour: str) -> int:
    """Pixels of a picture that have a colour."""
    picture = np.asarray(Image.open(path).convert("RGB")).astype(int)
    wanted = np.array([round(255 * part) for part in to_rgb(colour)])
    return int((abs(picture - wanted).sum(axis=2) < 12).sum())
