"""A photograph of one or many bands as one grey raster: its luminance, or its first principal component."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.pipeline import Pass, Setting
from tilepipe.engine.work import Work
from tilepipe.errors import InputError
from tilepipe.io.files.gdal_options import input_options
from tilepipe.io.files.paths import gdal_name, location
from tilepipe.io.rasters.bands import Bands, Choice
from tilepipe.io.rasters.file_bands import bands_of
from tilepipe.io.rasters.raster import Raster, open_bands, open_raster
from tilepipe.io.rasters.sources.arrays import ARRAY, array_bands
from tilepipe.io.rasters.sources.axes import bands_first
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, Window

LUMINANCE = (0.299, 0.587, 0.114)
"""Weights of red, green and blue (ITU-R BT.601)."""

PRINCIPAL_COMPONENT = "first principal component"

Grey = Literal["automatic", "luminance", "principal"]

_MOST_SAMPLES = 1 << 18
"""Pixels of which the principal component is found."""


@dataclass(frozen=True)
class Photograph:
    """Bands on one pixel grid and their weights in the grey value.

    Attributes
    ----------
    raster
        Of one or many bands.
    weights
        Weight of each band; None = the first principal component, not found yet.
    conversion
        What the grey value is: ``single band``, ``luminance`` or ``first principal component``.
    """

    raster: Raster
    weights: tuple[float, ...] | None
    conversion: str

    def read(self, window: Window) -> NDArray[np.float32]:
        """Grey values of a window, float32; NaN where the pixel is nodata."""
        if self.weights is None:
            raise ValueError("the weights of the bands are not known yet")
        if self.weights == (1.0,):
            return self.raster.read(window)
        first, *others = self.weights
        bands = self.raster.read_bands(window)
        grey = next(bands) * np.float32(first)
        for band, weight in zip(bands, others, strict=True):
            grey += band * np.float32(weight)
        return grey

    @property
    def spacing(self) -> int:
        """Distance in pixels of the global rows and columns of which samples are taken."""
        return max(1, math.isqrt(math.prod(self.raster.shape) // _MOST_SAMPLES))

    def with_principal_component(self, facts: Iterable[Facts]) -> Photograph:
        """Weights from the samples of all tiles, which are put into the order of the raster first.

        Raises
        ------
        InputError
            When no pixel is valid.
        """
        parts = list(facts)
        order = np.argsort(np.concatenate([part["site"] for part in parts]), kind="stable")
        samples = np.concatenate([part["sample"] for part in parts])[order].astype(np.float64)
        if not len(samples):
            raise InputError(
                f"{self.raster.names[0]}: holds nothing but nodata; check the nodata value or choose a --band"
            )
        return replace(self, weights=principal_weights(samples))


def principal_weights(samples: NDArray[np.float64]) -> tuple[float, ...]:
    """Direction of the largest variance of samples (n, bands), scaled to a sum of absolute weights of 1.

    Its sign is such that the weights sum to more than 0: bright stays bright.
    """
    deviations = samples - samples.mean(axis=0)
    _, vectors = np.linalg.eigh(deviations.T @ deviations)
    axis = vectors[:, -1]
    axis = axis * (1 if axis.sum() >= 0 else -1) / np.abs(axis).sum()
    # rounded, so that the last bits of a solver do not show
    return tuple(float(weight) for weight in np.round(axis, 6))


def sample_bands(photograph: Photograph, tile: Tile) -> Facts:
    """Tile function (halo 0): facts are the valid pixels of a global lattice."""
    core, spacing = tile.core, photograph.spacing
    rows = np.arange(-(-core.top // spacing) * spacing, core.bottom, spacing)
    columns = np.arange(-(-core.left // spacing) * spacing, core.right, spacing)
    at = np.ix_(rows - core.top, columns - core.left)
    values = np.stack([band[at].reshape(-1) for band in photograph.raster.read_bands(core)], axis=1)
    site = (rows[:, None] * photograph.raster.shape[1] + columns).reshape(-1)
    valid = ~np.isnan(values).any(axis=1)
    return {"site": site[valid], "sample": values[valid]}


def _needs_principal_component(setting: Setting) -> bool:
    return bool(setting.found.get("grey") == PRINCIPAL_COMPONENT)


BANDS = Pass("bands", sample_bands, halo=0, bytes_per_pixel=16, needed=_needs_principal_component, on_device=False)


def grey_photograph(run: Work) -> Photograph:
    """The photograph with the weights of its bands, which a principal component needs a pass for."""
    photograph: Photograph = run.source
    if photograph.weights is not None:
        return photograph
    return photograph.with_principal_component(run.over_tiles(BANDS, photograph).each())


def open_photograph(inputs: Sequence[Any], *, crs: str | None, band: int | None, grey: Grey) -> Photograph:
    """Open one or many images as one photograph.

    Parameters
    ----------
    inputs
        Paths or xarray arrays, one mosaic; all have the same bands.
    crs
        ``EPSG:n`` for inputs that name no CRS.
    band
        The only band to use; None = all but an alpha band.
    grey
        ``luminance`` needs red, green and blue; ``principal`` at least two bands; ``automatic`` takes one band as is,
        luminance where there are three bands or bands are tagged red, green and blue, else the first principal
        component.

    Raises
    ------
    InputError
        As `open_raster`; or when the bands do not suit ``grey``.
    """
    if not inputs:
        raise InputError("no input image: name at least one file")
    bands = _bands(inputs[0])
    if len(bands.image) == 1 and bands.palettes == bands.image and band in (None, *bands.image):
        # red, green and blue of its entries
        bands, band = Bands((1, 2, 3), None, (1, 2, 3)), None
    if band is not None or len(bands.image) <= 1:
        raster = open_raster(inputs, crs=crs, band=band)
        if grey != "automatic":
            which = "it has one band" if band is None else f"--band {band} chooses one band"
            raise InputError(f"{_name(inputs[0])}: {which}, which is grey as it is; leave out --set grey={grey}")
        return Photograph(raster, (1.0,), "single band")
    if grey == "luminance" and bands.colours is None:
        raise InputError(
            f"{_name(inputs[0])}: has {len(bands.image)} bands and none tagged as red, green and blue; "
            "use --set grey=principal or --band n"
        )
    if grey != "principal" and bands.colours is not None:
        raster = open_bands(inputs, Choice(bands.colours, colours=True), crs=crs)
        return Photograph(raster, LUMINANCE, "luminance")
    every = Choice(bands.image, colours=bands.colours == bands.image)
    return Photograph(open_bands(inputs, every, crs=crs), None, PRINCIPAL_COMPONENT)


def _name(item: Any) -> str:
    return location(item) if isinstance(item, (str, Path)) else ARRAY


def _bands(item: Any) -> Bands:
    """The bands of an input; none where only opening it tells, or says what is wrong."""
    if not isinstance(item, (str, Path)):
        return array_bands(bands_first(item, ARRAY))
    if Path(location(item)).is_dir():
        return Bands(())
    import rasterio
    from rasterio.errors import RasterioError

    try:
        with input_options(), rasterio.open(gdal_name(item)) as dataset:
            return bands_of(dataset)
    except RasterioError:
        return Bands(())
