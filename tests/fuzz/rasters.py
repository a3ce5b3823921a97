"""Readers of rasters: TIFF, VRT, Zarr."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import rasterio
import zarr
from rasterio.transform import from_origin

from tests.fuzz.mutations import mutated_bytes, mutated_field, mutated_json, mutated_text
from tests.fuzz.reader import Reader
from tilepipe.io.rasters.raster import open_raster
from tilepipe.tiling.grid import Window

_SIZE = 16
_MOST = 64
"""Rows and columns that are read at once at most, as of a tile."""


def _read(path: Path) -> None:
    """Open a raster, read both its ends, and check that it is what it was."""
    raster = open_raster([path], band=1)
    raster.check_heights()
    rows, columns = raster.shape
    for top, left in {(0, 0), (max(rows - _MOST, 0), max(columns - _MOST, 0))}:
        window = Window(top, left, min(top + _MOST, rows), min(left + _MOST, columns))
        assert raster.read(window).shape == window.shape
    source = raster.members[0].source
    assert source.lines and source.stamp and source.content
    source.check()


def _write(path: Path, **options: Any) -> bytes:
    values = np.arange(_SIZE * _SIZE, dtype=options.pop("dtype", "float32")).reshape(_SIZE, _SIZE)
    place = {"crs": "EPSG:32633", "transform": from_origin(392000, 5820000, 0.5, 0.5)}
    size = {"width": _SIZE, "height": _SIZE, "count": 1, "dtype": values.dtype}
    with rasterio.open(path, "w", driver="GTiff", **place, **size, **options) as file:
        file.write(values, 1)
    return path.read_bytes()


def _tiffs(folder: Path) -> list[bytes]:
    tiled = {"tiled": True, "blockxsize": 16, "blockysize": 16}
    return [
        _write(folder / "plain.tif", nodata=-1),
        _write(folder / "tiled.tif", compress="deflate", predictor=3, **tiled),
        _write(folder / "big.tif", BIGTIFF="YES", compress="lzw"),
        _write(folder / "grey.tif", dtype="uint8", ENDIANNESS="BIG"),
        _write(folder / "coded.tif", dtype="int16", compress="zstd", nodata=0),
    ]


def _read_tiff(content: bytes, folder: Path) -> None:
    path = folder / "a.tif"
    path.write_bytes(content)
    _read(path)


def _mutated_tiff(content: bytes, random: Random) -> bytes:
    """A TIFF with another tag, type, count or value in its first directory, or other bytes."""
    if len(content) < 8 or random.random() < 0.3:
        return mutated_bytes(content, random)
    order = ">" if content[:2] == b"MM" else "<"
    big = content[2:4] in (b"\x2b\0", b"\0\x2b")
    word, count, size = ("Q", "Q", 20) if big else ("I", "H", 12)
    try:
        (first,) = struct.unpack_from(order + word, content, 8 if big else 4)
        (number,) = struct.unpack_from(order + count, content, first)
    except struct.error:
        return mutated_bytes(content, random)
    entry = first + struct.calcsize(order + count) + size * random.randrange(min(number, 64) or 1)
    after = 4 + struct.calcsize(order + word)
    place, kind = random.choice(((0, "H"), (2, "H"), (4, word), (after, word), (after, "H")))
    return mutated_field(content, entry + place, order + kind, random)


_BAND = """<VRTDataset rasterXSize="16" rasterYSize="16"><SRS>EPSG:32633</SRS>
<GeoTransform>392000, 0.5, 0, 5820000, 0, -0.5</GeoTransform>
<VRTRasterBand dataType="Float32" band="1"><NoDataValue>-1</NoDataValue><Scale>2</Scale><Offset>1</Offset>
<UnitType>m</UnitType>{}</VRTRasterBand></VRTDataset>"""

_SOURCES = (
    """<SimpleSource><SourceFilename relativeToVRT="1">a.tif</SourceFilename><SourceBand>1</SourceBand>
<SourceProperties RasterXSize="16" RasterYSize="16" DataType="Float32" BlockXSize="16" BlockYSize="16"/>
<SrcRect xOff="0" yOff="0" xSize="16" ySize="16"/><DstRect xOff="0" yOff="0" xSize="16" ySize="16"/></SimpleSource>""",
    """<ComplexSource resampling="bilinear"><SourceFilename relativeToVRT="1">a.tif</SourceFilename>
<SourceBand>1</SourceBand><NODATA>0</NODATA><ScaleOffset>1</ScaleOffset><ScaleRatio>2</ScaleRatio>
<LUT>0:0,9:255</LUT><DstRect xOff="-2" yOff="2.5" xSize="8" ySize="8"/></ComplexSource>""",
    """<KernelFilteredSource><SourceFilename relativeToVRT="1">a.tif</SourceFilename>
<Kernel normalized="1"><Size>3</Size><Coefs>1 1 1 1 1 1 1 1 1</Coefs></Kernel></KernelFilteredSource>""",
)

_RAW = """<VRTDataset rasterXSize="16" rasterYSize="16"><SRS>EPSG:32633</SRS>
<GeoTransform>392000, 0.5, 0, 5820000, 0, -0.5</GeoTransform>
<VRTRasterBand dataType="Byte" band="1" subClass="VRTRawRasterBand">
<SourceFilename relativeToVRT="1">a.tif</SourceFilename>
<ImageOffset>8</ImageOffset><PixelOffset>1</PixelOffset><LineOffset>16</LineOffset>
<ByteOrder>LSB</ByteOrder></VRTRasterBand></VRTDataset>"""

_WARPED = """<VRTDataset rasterXSize="16" rasterYSize="16" subClass="VRTWarpedDataset"><SRS>EPSG:32633</SRS>
<GeoTransform>392000, 0.5, 0, 5820000, 0, -0.5</GeoTransform>
<VRTRasterBand dataType="Float32" band="1" subClass="VRTWarpedRasterBand"/><BlockXSize>16</BlockXSize>
<BlockYSize>16</BlockYSize><GDALWarpOptions><WarpMemoryLimit>6.7e7</WarpMemoryLimit>
<ResampleAlg>Bilinear</ResampleAlg><SourceDataset relativeToVRT="1">a.tif</SourceDataset><Transformer>
<GenImgProjTransformer><SrcGeoTransform>392000,0.5,0,5820000,0,-0.5</SrcGeoTransform>
<DstGeoTransform>392000,0.5,0,5820000,0,-0.5</DstGeoTransform></GenImgProjTransformer></Transformer>
<BandList><BandMapping src="1" dst="1"/></BandList></GDALWarpOptions></VRTDataset>"""

_pixels: list[bytes] = []
"""The raster that stands behind every VRT, made once."""


def _vrts(folder: Path) -> list[bytes]:
    return [text.encode() for text in (*map(_BAND.format, _SOURCES), _RAW, _WARPED)]


def _read_vrt(content: bytes, folder: Path) -> None:
    if not _pixels:
        _pixels.append(_write(folder / "a.tif"))
    (folder / "a.tif").write_bytes(_pixels[0])
    path = folder / "a.vrt"
    path.write_bytes(content)
    _read(path)


_CHUNK = "c/0/0"


def _stores(folder: Path) -> list[bytes]:
    """Description of an array, a line feed, and the bytes of its only chunk."""
    seeds = []
    for name, codec in (("zstd", "auto"), ("blosc", [zarr.codecs.BloscCodec(cname="lz4")]), ("gzip", "auto")):
        attributes = {"grid_mapping": "spatial_ref", "scale_factor": 0.5, "units": "m", "_FillValue": -1}
        store = folder / name
        array = zarr.create_array(
            store,
            shape=(_SIZE, _SIZE),
            chunks=(_SIZE, _SIZE),
            dtype="int16",
            compressors=codec,
            dimension_names=("y", "x"),
            attributes=attributes,
        )
        array[:] = 7
        description = json.dumps(json.loads((store / "zarr.json").read_bytes()))
        seeds.append(description.encode() + b"\n" + (store / _CHUNK).read_bytes())
    return seeds


def _read_store(content: bytes, folder: Path) -> None:
    description, _, chunk = content.partition(b"\n")
    store = folder / "a.zarr"
    group = zarr.open_group(store, mode="w")
    for name, first, step in (("y", 5820000 - 0.25, -0.5), ("x", 392000.25, 0.5)):
        centres = first + step * np.arange(_SIZE)
        group.create_array(name, shape=(_SIZE,), dtype="float64", dimension_names=(name,))[:] = centres
    system = {"crs_wkt": rasterio.CRS.from_epsg(32633).to_wkt()}
    group.create_array("spatial_ref", shape=(), dtype="int64", attributes=system)
    file = store / "height" / _CHUNK
    file.parent.mkdir(parents=True)
    file.write_bytes(chunk)
    (store / "height" / "zarr.json").write_bytes(description)
    _read(store)


def _mutated_store(content: bytes, random: Random) -> bytes:
    description, _, chunk = content.partition(b"\n")
    if random.random() < 0.8:
        description = mutated_json(description, random).replace(b"\n", b" ")
    else:
        chunk = mutated_bytes(chunk, random)
    return description + b"\n" + chunk


READERS = (
    Reader("tiff", _tiffs, _read_tiff, _mutated_tiff),
    Reader("vrt", _vrts, _read_vrt, mutated_text),
    Reader("zarr", _stores, _read_store, _mutated_store),
)
