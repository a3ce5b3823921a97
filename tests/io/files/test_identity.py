"""Files that are replaced, written to or touched are told apart from those that a run began with."""

from __future__ import annotations

import os
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
import zarr

from tests.io.rasters.test_raster import grid_array, numbers, write_raster
from tilepipe.io.files import identity
from tilepipe.io.files.identity import ChangedInputError, Files, FileState, files_of
from tilepipe.io.rasters.raster import open_raster
from tilepipe.io.rasters.sources import stores
from tilepipe.io.rasters.sources.source import Source
from tilepipe.tiling.grid import Window

SECOND = 1_000_000_000


@pytest.fixture(autouse=True)
def _fresh(monkeypatch):
    """Nothing is known of files from other tests."""
    monkeypatch.setattr(identity, "_seen", {})
    monkeypatch.setattr(stores, "_seen", {})


def elsewhere(monkeypatch) -> None:
    """What follows is another process, perhaps on another machine."""
    monkeypatch.setattr(identity, "_seen", {})
    monkeypatch.setattr(stores, "_seen", {})


def source_of(*paths: Path) -> Source:
    return open_raster([*paths]).members[0].source


def file_of(path: Path) -> Files:
    return files_of(str(path), [(str(path), None)])


def test_an_untouched_file_is_the_same(tmp_path, monkeypatch):
    source = source_of(write_raster(tmp_path / "a.tif", numbers()))
    source.check()
    elsewhere(monkeypatch)
    source.check(Window(0, 0, 2, 2))


def test_a_replaced_file_is_named(tmp_path):
    path = write_raster(tmp_path / "a.tif", numbers())
    source = source_of(path)
    write_raster(path, -numbers())
    with pytest.raises(ChangedInputError, match=r"a\.tif: has changed since the run began; nothing is published"):
        source.check()


def test_a_replacement_of_the_same_size_and_time_is_noticed(tmp_path, monkeypatch):
    path, other = tmp_path / "a.bin", tmp_path / "b.bin"
    path.write_bytes(bytes(1_000_000))
    other.write_bytes(bytes(999_999) + b"\1")
    status = path.stat()
    os.utime(other, ns=(status.st_atime_ns, status.st_mtime_ns))
    files = file_of(path)
    shutil.copy2(other, path)
    with pytest.raises(ChangedInputError, match="has changed"):
        files.check()
    elsewhere(monkeypatch)
    with pytest.raises(ChangedInputError, match="has changed"):
        files.check()


def changed_between_the_samples(path: Path, place: int) -> None:
    """Write into a file so that its size and time stay."""
    status = path.stat()
    with path.open("r+b") as file:
        file.seek(place)
        before = file.read(1)
        file.seek(place)
        file.write(bytes([before[0] ^ 1]))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))


def test_a_change_between_the_samples_that_keeps_the_time_is_noticed(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(1_000_000))
    files = file_of(path)
    changed_between_the_samples(path, 50_000)
    with pytest.raises(ChangedInputError, match="has been written to since the run began"):
        files.check()
    assert file_of(path).lines != files.lines and file_of(path).content == files.content
    # another machine may see other times
    pickle.loads(pickle.dumps(files)).check()


def test_a_change_of_a_chunk_that_keeps_the_time_is_noticed(tmp_path):
    values = np.zeros((80, 80), np.float32)
    zarr.create_array(tmp_path / "a.zarr" / "a", shape=values.shape, chunks=(8, 8), dtype="float32", compressors=None)
    zarr.open_array(tmp_path / "a.zarr" / "a", mode="r+")[:] = 1
    files = stores.store_files(tmp_path / "a.zarr", "a.zarr", "a", ["y", "x"])
    chunks = sorted((tmp_path / "a.zarr" / "a" / "c").rglob("*/*"))
    changed_between_the_samples(chunks[5], 9)
    files.check(Window(40, 40, 80, 80))
    for window in (Window(0, 0, 80, 80), None):
        with pytest.raises(ChangedInputError, match="has been written to since the run began"):
            files.check(window)
    assert stores.store_files(tmp_path / "a.zarr", "a.zarr", "a", ["y", "x"]).lines != files.lines
    pickle.loads(pickle.dumps(files)).check()


def test_each_file_counts_by_itself(tmp_path):
    """Two files that swap their sizes have the same sum, and one that grows older has no newer time of change."""
    a, b = tmp_path / "a.bin", tmp_path / "b.bin"
    a.write_bytes(b"one"), b.write_bytes(b"three")
    os.utime(a, ns=(SECOND, SECOND))
    before = files_of("both", [(str(a), None), (str(b), None)])
    content = a.read_bytes(), b.read_bytes()
    a.write_bytes(content[1]), b.write_bytes(content[0])
    assert files_of("both", [(str(a), None), (str(b), None)]).stamp != before.stamp
    a.write_bytes(content[0]), b.write_bytes(content[1])
    os.utime(a, ns=(SECOND // 2, SECOND // 2))
    assert files_of("both", [(str(a), None), (str(b), None)]).stamp != before.stamp


def test_a_touched_file_is_said_to_be_perhaps_the_same(tmp_path):
    path = write_raster(tmp_path / "a.tif", np.zeros((300, 300), np.float32))
    source = source_of(path)
    os.utime(path)
    with pytest.raises(ChangedInputError, match=r"has been written to since the run began.*run the same command again"):
        source.check()
    assert source_of(path).content == source.content
    assert source_of(path).stamp != source.stamp


def test_of_a_small_file_all_is_compared(tmp_path):
    path = write_raster(tmp_path / "a.tif", numbers())
    source = source_of(path)
    os.utime(path)
    source.check()


def test_rights_and_names_are_no_content(tmp_path):
    path = write_raster(tmp_path / "a.tif", numbers())
    source = source_of(path)
    path.chmod(0o600)
    path.rename(tmp_path / "b.tif")
    (tmp_path / "b.tif").rename(path)
    source.check()


def test_a_file_that_is_gone_is_named(tmp_path):
    path = write_raster(tmp_path / "a.tif", numbers())
    source = source_of(path)
    path.unlink()
    with pytest.raises(ChangedInputError, match=r"a\.tif: is gone since the run began"):
        source.check()


@pytest.mark.parametrize("seen", [0, SECOND // 2, 1_999_999_999])
def test_another_machine_may_see_whole_seconds(tmp_path, monkeypatch, seen):
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(100_000))
    os.utime(path, ns=(0, 10 * SECOND + seen))
    files = file_of(path)
    files = pickle.loads(pickle.dumps(files))
    elsewhere(monkeypatch)
    os.utime(path, ns=(0, 10 * SECOND))
    files.check()
    os.utime(path, ns=(0, 14 * SECOND))
    with pytest.raises(ChangedInputError):
        files.check()


def test_side_files_count_where_they_decide_values(tmp_path):
    path = write_raster(tmp_path / "a.tif", numbers())
    source, side = source_of(path), tmp_path / "a.tif.aux.xml"
    side.write_text(
        "<PAMDataset><PAMRasterBand band='1'>\n<Histograms><HistItem/></Histograms>"
        "<Metadata><MDI key='STATISTICS_MEAN'>1</MDI></Metadata></PAMRasterBand></PAMDataset>"
    )
    (tmp_path / "a.tif.ovr").write_bytes(b"overviews")
    source.check()
    side.write_text("<PAMDataset><PAMRasterBand band='1'><NoDataValue>3</NoDataValue></PAMRasterBand></PAMDataset>")
    with pytest.raises(ChangedInputError, match=r"a\.tif: its .*aux\.xml: has changed"):
        source.check()


def test_a_mask_that_appears_is_noticed(tmp_path):
    path = write_raster(tmp_path / "a.tif", numbers())
    source = source_of(path)
    write_raster(tmp_path / "a.tif.msk", numbers())
    with pytest.raises(ChangedInputError, match=r"a\.tif: its .*\.msk: has changed"):
        source.check()


def _store(path: Path, values: np.ndarray) -> Path:
    grid_array(values).chunk(y=4, x=3).to_dataset(name="a").to_zarr(path, mode="w", zarr_format=3, consolidated=False)
    return path


def test_chunks_of_a_store_count_where_they_are_read(tmp_path):
    source = source_of(_store(tmp_path / "a.zarr", numbers()))
    source.check()
    zarr.open_array(tmp_path / "a.zarr" / "a", mode="r+")[0, 0] = 99
    source.check(Window(4, 3, 7, 9))
    for window in (Window(0, 0, 1, 1), Window(3, 2, 6, 6), None):
        with pytest.raises(ChangedInputError, match=r"a\.zarr: has "):
            source.check(window)


@pytest.mark.parametrize("arrangement", ["ascending", "transposed", "band"])
def test_chunks_of_a_store_are_found_however_it_lies(tmp_path, arrangement):
    values = numbers()
    array = grid_array(values).chunk(y=4, x=3)
    arranged = {
        "ascending": lambda: array[::-1].chunk(y=4),
        "transposed": lambda: array.transpose("x", "y"),
        "band": lambda: xr.concat([array, array], "band"),
    }[arrangement]()
    for item in arranged.coords.values():
        item.encoding.clear()
    arranged.encoding.clear()
    arranged.to_dataset(name="a").to_zarr(tmp_path / "a.zarr", zarr_format=2, consolidated=False)
    source = open_raster([tmp_path / "a.zarr"], band=2 if arrangement == "band" else None).members[0].source
    source.check()
    stored = zarr.open_array(tmp_path / "a.zarr" / "a", mode="r+")
    # the first pixel of the north-western corner
    stored[{"ascending": (6, 0), "transposed": (0, 0), "band": (1, 0, 0)}[arrangement]] = 99
    source.check(Window(4, 3, 7, 9))
    with pytest.raises(ChangedInputError):
        source.check(Window(0, 0, 1, 1))


def test_an_array_in_memory_that_was_changed_is_noticed():
    array = grid_array(numbers())
    source = open_raster([array]).members[0].source
    assert source.content
    source.check()
    array[0, 0] = 99
    with pytest.raises(ChangedInputError, match="the array: has changed"):
        source.check()


SECOND = 10**9


@pytest.mark.parametrize(
    ("a", "b", "same"),
    [
        (5 * SECOND + 1, 5 * SECOND + 1000, True),
        (5 * SECOND + 1, 5 * SECOND + 1001, False),
        # a file system that keeps whole seconds beside one that keeps more: even seconds, rounded either way
        (4 * SECOND, 4 * SECOND + 123, True),
        (4 * SECOND, 6 * SECOND - 1, True),
        (6 * SECOND - 1, 4 * SECOND, True),
        (4 * SECOND, 6 * SECOND + 1, False),
        (4 * SECOND, 2 * SECOND - 1, False),
        # two of whole seconds
        (4 * SECOND, 4 * SECOND, True),
        (4 * SECOND, 5 * SECOND, False),
    ],
)
def test_times_that_may_be_the_same_one(a, b, same):
    large = 1 << 20
    assert FileState(large, a, "x").is_same(FileState(large, b, "x")) == same
    assert FileState(large, b, "x").is_same(FileState(large, a, "x")) == same
    # of a small file all is sampled, up to eight pieces of 8 KiB
    assert FileState(8 * (8 << 10), a, "x").is_same(FileState(8 * (8 << 10), b, "x"))
    assert FileState(8 * (8 << 10) + 1, a, "x").is_same(FileState(8 * (8 << 10) + 1, b, "x")) == same
    assert not FileState(large, a, "x").is_same(FileState(large, a, "y"))
    assert not FileState(large, a, "x").is_same(FileState(large + 1, a, "x"))
