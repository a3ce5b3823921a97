"""The scenes of ``objects``: heights and what is known to stand there, from a synthetic city and two real surveys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure.contest import Unsuitable
from tilepipe.pipelines.points.recipe import grid_clouds
from tilepipe.synthetic import City, write_city

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
"""Where the real surveys lie, beside the checkout; absent elsewhere."""

NAMES = ("city", "amsterdam", "montpellier")

RESOLUTION = 0.5
VOID_REACH = 3.0
"""Metres that heights are carried into cells without points."""

Geometries = NDArray[np.object_]


@dataclass(frozen=True)
class ObjectScene:
    """A raster of heights and the buildings in it.

    Attributes
    ----------
    name
        As in the tables.
    raster
        Heights in metres.
    truth
        Shapely polygons of the true buildings, in metres.
    area
        Where the truth is complete; None = everywhere.
    shape
        Rows and columns of the raster.
    source
        Where heights and truth come from, for the page.
    """

    name: str
    raster: Path
    truth: Geometries
    area: Any
    shape: tuple[int, int]
    source: str

    @property
    def megapixels(self) -> float:
        """Number of pixels in millions."""
        return self.shape[0] * self.shape[1] / 1e6


def prepare(name: str, folder: Path, *, size: int, workers: int, data: Path = DATA) -> ObjectScene:
    """Write a scene's raster into a folder.

    Parameters
    ----------
    name
        One of `NAMES`.
    folder
        For the raster.
    size
        Side of the synthetic city in pixels.
    workers
        Threads.
    data
        Folder of the real surveys.

    Raises
    ------
    Unsuitable
        When the survey is not there.
    """
    if name == "city":
        return _city(folder, size, workers)
    survey, make = {"amsterdam": ("amsterdam_ahn3_bag", _amsterdam), "montpellier": ("ign_montpellier", _montpellier)}[
        name
    ]
    if not (data / survey).is_dir():
        raise Unsuitable(f"its survey is not here: no folder {survey} in {data}")
    return make(data / survey, folder, workers)


def _city(folder: Path, size: int, workers: int) -> ObjectScene:
    import geopandas

    city = City(rows=size, columns=size)
    paths = write_city(folder, city, layers=("height",), workers=workers)
    truth = geopandas.read_parquet(paths["footprints"]).geometry.to_numpy()
    source = f"synthetic, {size}² pixels of {city.resolution:g} m; truth: the footprints that it was made of"
    return ObjectScene(f"city {size}²", paths["height"], truth, None, city.shape, source)


def _amsterdam(survey: Path, folder: Path, workers: int) -> ObjectScene:
    import geopandas
    import shapely

    raster = _gridded(sorted(survey.glob("*.laz")), folder / "height.tif", workers, crs="EPSG:28992")
    area = geopandas.read_file(survey / "eval_aoi.geojson").to_crs("EPSG:28992").geometry.union_all()
    truth = shapely.force_2d(geopandas.read_file(survey / "pandactueelbestaand.gpkg").geometry.to_numpy())
    source = "AHN3 lidar, highest first return; truth: the cadastre's footprints (BAG) within eval_aoi.geojson"
    return ObjectScene("Amsterdam", raster, truth, area, _shape(raster), source)


def _montpellier(survey: Path, folder: Path, workers: int) -> ObjectScene:
    clouds = sorted(survey.glob("test_data_*.laz"))
    raster = _gridded(clouds, folder / "height.tif", workers)
    roofs = _gridded(clouds, folder / "roofs.tif", workers, classes=(6,))
    truth = _where_highest(roofs, raster)
    source = "IGN LiDAR HD, highest first return; truth: pixels whose highest return the survey classed as building (6)"
    return ObjectScene("Montpellier", raster, truth, None, _shape(raster), source)


def _gridded(
    clouds: Sequence[Path], out: Path, workers: int, crs: str | None = None, classes: Sequence[int] | None = None
) -> Path:
    return grid_clouds(
        clouds, out, resolution=RESOLUTION, value="height", method="max", returns="first", void_reach=VOID_REACH,
        crs=crs, classes=classes, workers=workers,
    )  # fmt: skip


def _where_highest(part: Path, whole: Path) -> Geometries:
    """Polygons of the pixels where one raster is as high as the other; both have the whole's extent or less."""
    import rasterio
    import shapely
    from rasterio.features import shapes
    from rasterio.windows import from_bounds
    from shapely.geometry import shape

    with rasterio.open(part) as some, rasterio.open(whole) as all_points:
        window = from_bounds(*some.bounds, transform=all_points.transform).round_offsets().round_lengths()
        same = np.isclose(some.read(1), all_points.read(1, window=window), atol=0.005)
        found = shapes(same.astype(np.uint8), mask=same, connectivity=4, transform=some.transform)
        polygons: Geometries = np.array([shape(geometry) for geometry, _ in found], dtype=object)
    mended: Geometries = shapely.make_valid(polygons)
    return mended


def _shape(raster: Path) -> tuple[int, int]:
    import rasterio

    with rasterio.open(raster) as file:
        return int(file.height), int(file.width)
