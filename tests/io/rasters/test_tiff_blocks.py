"""The end of the pixels of a TIFF as GDAL tells it block by block, for every layout, and at once for huge rasters."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
import rasterio

from tilepipe.io.rasters.sources.tiff_blocks import end_of_pixels

LAYOUTS = {
    "one strip": {"blockysize": 300},
    "strips": {"blockysize": 7},
    "tiles": {"tiled": True, "blockxsize": 64, "blockysize": 32},
    "bands apart": {"tiled": True, "blockxsize": 64, "blockysize": 64, "interleave": "band"},
    "bands together": {"tiled": True, "blockxsize": 64, "blockysize": 64, "interleave": "pixel"},
    "big": {"bigtiff": "yes", "tiled": True, "blockxsize": 64, "blockysize": 64},
    "big-endian": {"endianness": "big", "compress": "deflate"},
    "sparse": {"sparse_ok": True, "tiled": True, "blockxsize": 64, "blockysize": 64, "compress": "deflate"},
}


def end_by_blocks(path: Path) -> int:
    with rasterio.open(path) as dataset:
        return max(
            sum(
                int(dataset.get_tag_item(f"BLOCK_{item}_{column}_{row}", "TIFF", bidx=band) or 0)
                for item in ("OFFSET", "SIZE")
            )
            for band in dataset.indexes
            for (row, column), _ in dataset.block_windows(band)
        )


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_it_is_that_of_the_last_block(tmp_path, layout) -> None:
    path = tmp_path / "a.tif"
    values = np.random.default_rng(0).integers(0, 9, (2, 300, 200), dtype=np.uint16)
    with rasterio.open(path, "w", driver="GTiff", width=200, height=300, count=2, dtype="uint16", **layout) as dataset:
        dataset.write(values if not layout.get("sparse_ok") else values * 0)
        if layout.get("sparse_ok"):
            dataset.write(values[:, :64, 64:128], window=rasterio.windows.Window(64, 0, 64, 64))
    directory = 1 << 13
    assert end_by_blocks(path) <= end_of_pixels(path) <= max(end_by_blocks(path), directory)
    whole, size = path.read_bytes(), end_by_blocks(path)
    path.write_bytes(whole[: size - 1])
    assert end_of_pixels(path) > size - 1
    path.write_bytes(whole[:12])
    assert end_of_pixels(path) > 12


def test_other_files_are_refused(tmp_path) -> None:
    path = tmp_path / "a.tif"
    for content in (b"II", b"text, which is no image", b"MM\0\x2a"):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="no TIFF"):
            end_of_pixels(path)


def test_a_huge_empty_raster_takes_no_time(tmp_path) -> None:
    """A terapixel in four million blocks."""
    path = tmp_path / "huge.tif"
    profile = {"tiled": True, "blockxsize": 512, "blockysize": 512, "sparse_ok": True, "bigtiff": "yes"}
    with rasterio.open(path, "w", driver="GTiff", width=10**6, height=10**6, count=1, dtype="uint8", **profile):
        pass
    start = time.perf_counter()
    assert end_of_pixels(path) <= path.stat().st_size
    assert time.perf_counter() - start < 5


@pytest.mark.parametrize("layout", LAYOUTS.values(), ids=LAYOUTS)
def test_however_much_is_missing_there_must_be_more(tmp_path, layout) -> None:
    path, part = tmp_path / "a.tif", tmp_path / "part.tif"
    values = np.random.default_rng(0).integers(0, 9, (2, 100, 130), dtype=np.uint8)
    with rasterio.open(path, "w", driver="GTiff", width=130, height=100, count=2, dtype="uint8", **layout) as dataset:
        dataset.write(values)
    content, size = path.read_bytes(), end_by_blocks(path)
    for missing in (*range(1, 200), *range(200, size - 8, 101), *range(size - 1200, size - 7)):
        part.write_bytes(content[: size - missing])
        assert end_of_pixels(part) > size - missing, missing
