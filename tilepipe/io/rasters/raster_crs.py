"""CRS of rasters that their own format cannot hold: kept in the file that GDAL reads beside them."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from tilepipe.errors import InputError
from tilepipe.io.crs.systems import crs_of_dataset, crs_text, same_crs, understood_crs
from tilepipe.io.files.paths import side_file

if TYPE_CHECKING:
    from pyproj import CRS


def keep_crs(raster: Path, crs: object) -> None:
    """Make sure that the CRS of a written raster is read back as it was given.

    GeoTIFF keys do not hold every CRS, and GDAL writes some that they do not hold as another.  Where that has happened
    the CRS goes into the file beside the raster (GDAL's persistent auxiliary metadata), which GDAL, QGIS and this
    program prefer to what the raster says.

    Parameters
    ----------
    raster
        A finished raster.
    crs
        What it was given, as anything that pyproj accepts.

    Raises
    ------
    InputError
        GDAL does not read the CRS back from there either.

    Examples
    --------
    A local CRS of a site has no place in a GeoTIFF.

    >>> from pathlib import Path
    >>> import numpy as np
    >>> import rasterio
    >>> from tilepipe.io.files.paths import side_file
    >>> from tilepipe.io.rasters.raster_crs import keep_crs
    >>> site = 'ENGCRS["site",EDATUM["peg"],CS[Cartesian,2],AXIS["x",east],AXIS["y",north],LENGTHUNIT["metre",1]]'
    >>> profile = {"driver": "GTiff", "width": 3, "height": 3, "count": 1, "dtype": "uint8", "crs": site}
    >>> with rasterio.open("site.tif", "w", transform=rasterio.Affine(1, 0, 0, 0, -1, 3), **profile) as raster:
    ...     raster.write(np.zeros((1, 3, 3), np.uint8))
    >>> keep_crs(Path("site.tif"), site)
    >>> side_file(Path("site.tif")).exists()
    True
    """
    given = understood_crs(crs, str(raster))
    if _names(raster, given):
        return
    side = side_file(raster)
    root = ElementTree.parse(side).getroot() if side.exists() else ElementTree.Element("PAMDataset")
    for element in root.findall("SRS"):
        root.remove(element)
    ElementTree.SubElement(root, "SRS").text = given.to_wkt("WKT2_2019")
    ElementTree.ElementTree(root).write(side, encoding="utf-8")
    if not _names(raster, given):
        raise InputError(f"{raster}: GDAL keeps its CRS ({given.name}) in no raster; describe it in another way")


def check_raster_crs(crs: object, name: str) -> None:
    """Refuse a CRS that no raster of GDAL can hold, before any work.

    Parameters
    ----------
    crs
        Anything that pyproj accepts.
    name
        What has the CRS, for the message.

    Raises
    ------
    InputError
        GDAL reads the CRS back as another one, from a GeoTIFF and from the file beside it.

    Examples
    --------
    >>> from tilepipe.io.rasters.raster_crs import check_raster_crs
    >>> check_raster_crs("EPSG:28992", "a.tif")
    """
    import rasterio

    given = understood_crs(crs, name)
    profile = {"driver": "GTiff", "width": 1, "height": 1, "count": 1, "dtype": "uint8", "crs": crs_text(given)}
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.tif"
        with rasterio.open(path, "w", transform=rasterio.Affine(1, 0, 0, 0, -1, 1), **profile):
            pass
        try:
            keep_crs(path, given)
        except InputError as error:
            raise InputError(f"{name}{str(error).removeprefix(str(path))}") from None


def _names(raster: Path, crs: CRS) -> bool:
    """Whether a raster is read back with a CRS."""
    import rasterio

    with rasterio.open(raster) as dataset:
        found = crs_of_dataset(dataset)
    return found is not None and (crs_text(found) == crs_text(crs) or same_crs(found, crs))
