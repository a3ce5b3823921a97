"""The bands of an open raster file: their values with NaN where the pixel is void, and the colours of a palette."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.io.rasters.bands import Bands
from tilepipe.io.rasters.validity import Mask, decoded, is_colour, is_nodata, void_pixels


def bands_of(dataset: Any) -> Bands:
    """The bands of an open ``rasterio`` dataset.

    Examples
    --------
    >>> import rasterio
    >>> from tilepipe.io.rasters.file_bands import bands_of
    >>> from tilepipe.synthetic import City, write_city
    >>> written = write_city(".", City(rows=512, columns=512), layers=["height"], truth=False)
    >>> with rasterio.open(written["height"]) as dataset:
    ...     bands_of(dataset)
    Bands(image=(1,), alpha=None, colours=None, tagged=False, palettes=())
    """
    return Bands.of([meaning.name for meaning in dataset.colorinterp])


def read_bands(dataset: Any, bands: Sequence[int], **part: Any) -> Iterator[NDArray[np.float32]]:
    """Values of bands of an open file that make up one pixel together, band after band.

    Parameters
    ----------
    dataset
        An open ``rasterio`` dataset.
    bands
        Counted from 1. A band of a palette stands for its red, green and blue.
    part
        ``window``, ``out_shape`` and ``resampling`` of `rasterio.io.DatasetReader.read`.

    Yields
    ------
    ndarray of float32, shape (rows, columns)
        NaN where the pixel is void (`read_void`), in all bands alike.

    Examples
    --------
    >>> import rasterio
    >>> from tilepipe.io.rasters.file_bands import read_bands
    >>> from tilepipe.synthetic import City, write_city
    >>> written = write_city(".", City(rows=512, columns=512), layers=["height"], truth=False)
    >>> with rasterio.open(written["height"]) as dataset:
    ...     (heights,) = read_bands(dataset, [1], out_shape=(64, 64))
    >>> heights.shape, heights.dtype.name
    ((64, 64), 'float32')
    """
    if bands_of(dataset).palettes == tuple(bands):
        yield from _read_palette(dataset, bands[0], **part)
        return
    void = read_void(dataset, bands, **part)
    for band in bands:
        block = _read_band(dataset, band, **part)
        if void is not None:
            block[void] = np.nan
        yield block


def read_void(dataset: Any, bands: Sequence[int], **part: Any) -> Mask | None:
    """Where the pixels of an open file are void that consist of ``bands``; None = nowhere.

    The mask of a band is GDAL's: that of the file (``.msk`` or internal), else by ``NODATA_VALUES`` of the dataset,
    else by its nodata value. Alpha, wherever it lies, counts unless a mask or ``NODATA_VALUES`` takes its place.

    Examples
    --------
    >>> import rasterio
    >>> from tilepipe.io.rasters.file_bands import read_void
    >>> from tilepipe.synthetic import City, write_city
    >>> written = write_city(".", City(rows=512, columns=512), layers=["intensity"], truth=False)
    >>> with rasterio.open(written["intensity"]) as dataset:  # a raster of uint8 with nodata 0
    ...     bool((read_void(dataset, [1]) == (dataset.read(1) == 0)).all())
    True
    """
    from rasterio.enums import MaskFlags

    content = bands_of(dataset)
    if MaskFlags.per_dataset in dataset.mask_flag_enums[bands[0] - 1]:
        void: Mask | None = dataset.read_masks(bands[0], **part) == 0
    else:
        transparent = None if content.alpha is None else dataset.read(content.alpha, **part) <= 0
        # a pixel of a photograph is one of its whole dataset, not only of the bands that are used
        others = [band for band in content.image if band not in bands] if len(bands) > 1 else []
        missing = [_read_missing(dataset, band, content.alpha, **part) for band in (*bands, *others)]
        colours = [_is_colour(dataset, band) for band in bands] + [True] * len(others)
        void = void_pixels(missing, colours, transparent)
    if len(bands) > 1:
        for band in bands:
            if np.dtype(dataset.dtypes[band - 1]).kind == "f":
                unknown = np.isnan(_read_band(dataset, band, **part))
                void = unknown if void is None else void | unknown
    return void


def _read_band(dataset: Any, band: int, **part: Any) -> NDArray[np.float32]:
    return decoded(dataset.read(band, **part), dataset.scales[band - 1], dataset.offsets[band - 1])


def _read_missing(dataset: Any, band: int, alpha: int | None, **part: Any) -> Mask | None:
    """Where the mask of a band is 0; None = nowhere, but for values that are no numbers."""
    from rasterio.enums import MaskFlags

    flags, nodata = dataset.mask_flag_enums[band - 1], dataset.nodatavals[band - 1]
    if MaskFlags.all_valid in flags or (MaskFlags.nodata in flags and nodata != nodata):
        return None
    if MaskFlags.nodata in flags and alpha is not None:
        # the same as GDAL's mask, of which rasterio would warn that it hides alpha
        return is_nodata(dataset.read(band, **part), nodata)
    missing: Mask = dataset.read_masks(band, **part) == 0
    return missing


def _is_colour(dataset: Any, band: int) -> bool:
    from rasterio.enums import MaskFlags

    by_value = MaskFlags.nodata in dataset.mask_flag_enums[band - 1]
    return by_value and is_colour(dataset.nodatavals[band - 1], np.dtype(dataset.dtypes[band - 1]))


def _read_palette(dataset: Any, band: int, **part: Any) -> Iterator[NDArray[np.float32]]:
    """Red, green and blue of the indices of a palette, whose transparent entries are void as well."""
    entries = dataset.colormap(band)
    # an index beyond the palette has no colour
    colours = np.zeros((max(entries) + 2, 4), np.uint8)
    for index, entry in entries.items():
        colours[index] = entry
    part.pop("resampling", None)  # between two indices lies no colour
    pixels = np.take(colours, dataset.read(band, **part), axis=0, mode="clip")
    void = pixels[..., 3] == 0
    hidden = read_void(dataset, [band], **part)
    if hidden is not None:
        void |= hidden
    for channel in range(3):
        block = pixels[..., channel].astype(np.float32)
        block[void] = np.nan
        yield block
