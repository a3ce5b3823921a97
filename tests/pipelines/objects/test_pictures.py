"""Pictures of a small fabricated `objects` run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
import shapely
from matplotlib.colors import to_rgb
from PIL import Image
from rasterio.transform import from_origin

from tilepipe.io.vectors.formats import write_table
from tilepipe.pipelines.objects.pictures import BORDER_COLOURS, pictures

CRS = "EPSG:28992"
LEFT, TOP, SIDE = 120_000.0, 486_000.0, 60


def fabricate(folder: Path, doubtful: float) -> Path:
    """Three regions beside each other; the border of the first two is certain, that of the others ``doubtful``."""
    folder.mkdir()
    ids = np.repeat(np.arange(1, 4, dtype=np.uint32), SIDE)[None].repeat(SIDE, axis=0)
    profile = {"driver": "GTiff", "height": SIDE, "width": 3 * SIDE, "count": 1, "dtype": "uint32", "nodata": 0}
    with rasterio.open(folder / "regions.tif", "w", crs=CRS, transform=from_origin(LEFT, TOP, 1, 1), **profile) as file:
        file.write(ids, 1)
    steps = LEFT + SIDE * np.arange(4)
    boxes = shapely.box(steps[:-1], TOP - SIDE, steps[1:], TOP)
    write_table(
        folder / "objects.parquet",
        {"region_id": np.arange(1, 4), "posterior_mean": np.array([2.0, 8.0, 9.0])},
        boxes,
        CRS,
    )
    lines = [shapely.LineString([(x, TOP - SIDE), (x, TOP)]) for x in steps[1:3]]
    write_table(folder / "boundaries.parquet", {"probability_one_object": np.array([0.0, doubtful])}, lines, CRS)
    return folder


def row_through(path: Path, colour: str) -> int:
    """Pixels of one colour in the row through the middle of a picture."""
    picture = np.asarray(Image.open(path).convert("RGB")).astype(int)
    # off the colour bars, which lie beyond the map
    row = picture[picture.shape[0] // 2, : int(picture.shape[1] * 0.85)]
    return int((abs(row - [round(255 * part) for part in to_rgb(colour)]).sum(axis=1) < 12).sum())


def test_doubtful_borders_stand_out(tmp_path: Path) -> None:
    whole, certain, _ = pictures(fabricate(tmp_path / "certain", 0.0))
    _, doubtful, _ = pictures(fabricate(tmp_path / "doubtful", 0.25))
    assert row_through(certain, BORDER_COLOURS[1]) == row_through(whole, BORDER_COLOURS[1]) == 0
    assert row_through(doubtful, BORDER_COLOURS[1]) >= 3


@pytest.mark.parametrize("probability", [0.0, np.nan])
def test_the_detail_has_bars_of_heights_and_of_probabilities(tmp_path: Path, probability: float) -> None:
    whole, detail = (Image.open(path) for path in pictures(fabricate(tmp_path / "run", probability))[:2])
    for picture, bars in ((whole, 1), (detail, 2)):
        pixels = np.asarray(picture.convert("L"))
        # the last dark column is the outline of the bars, which are 16 pixels wide
        outline = np.flatnonzero((pixels < 60).mean(axis=0) > 0.25).max()
        middle = pixels[:, outline - 8]
        assert np.count_nonzero(np.diff((middle < 250).astype(int)) == 1) == bars
