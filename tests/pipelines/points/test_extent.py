"""Where the points lie decides, not the headers; points astray are named; a point in several clouds counts once."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import rasterio

from tests.io.clouds.test_cloud import read, write
from tilepipe.errors import InputError
from tilepipe.pipelines.points import survey
from tilepipe.pipelines.points.recipe import grid_clouds
from tilepipe_kernels.points.duplicates import counted_once, fingerprints

OFFSET = (600000.0, 4000000.0, 0.0)


@pytest.fixture
def scene() -> np.ndarray:
    """Coordinates of 5,000 points in a square of 40 m, shape (3, points)."""
    random = np.random.default_rng(0)
    x, y = 635000 + random.uniform(0.1, 39.9, (1, 5000)), 4295000 + random.uniform(0.1, 39.9, (1, 5000))
    return np.concatenate([x, y, random.normal(50, 1, (1, 5000))]).round(2)


def with_header_box(path: Path, lowest: tuple[float, ...], highest: tuple[float, ...]) -> Path:
    """The same cloud whose header tells of another bounding box."""
    data = bytearray(path.read_bytes())
    struct.pack_into("<6d", data, 179, *np.stack([highest, lowest], axis=1).ravel())
    other = path.with_name("other.las")
    other.write_bytes(data)
    return other


@pytest.mark.parametrize(
    ("lowest", "highest"),
    [
        ((0, 0, 0), (636000, 4296000, 100)),
        ((635000, 4295000, 0), (636000, 4296000, 200)),
        ((635010, 4295010, 50), (635020, 4295020, 51)),
        ((0, 0, 0), (0, 0, 0)),
        ((np.nan,) * 3, (np.inf,) * 3),
    ],
)
def test_the_box_of_the_header_does_not_matter(scene, tmp_path, lowest, highest) -> None:
    plain = write(tmp_path / "plain.las", *scene, offset=OFFSET)
    first = grid_clouds([plain], tmp_path / "first.tif", method="max")
    second = grid_clouds([with_header_box(plain, lowest, highest)], tmp_path / "second.tif", method="max")
    assert first.read_bytes() == second.read_bytes()
    with rasterio.open(second) as raster:
        x, y, _ = scene
        assert raster.bounds.left == np.floor(x.min() * 2) / 2 and raster.bounds.top == np.ceil(y.max() * 2) / 2
        assert raster.shape == (80, 80)


def test_extent_is_that_of_the_points_that_count(scene, tmp_path) -> None:
    """Noise and withheld points, here at a corner 900 m away, do not widen the raster."""
    x, y, z = np.append(scene, scene[:, :1] + [[900.0], [900.0], [0.0]], axis=1)
    classes = np.append(np.full(5000, 2, np.uint8), np.uint8(7))
    path = write(tmp_path / "noise.las", x, y, z, offset=OFFSET, classification=classes)
    assert read(grid_clouds([path], tmp_path / "o.tif", method="max")).shape == (80, 80)


@pytest.mark.parametrize("place", [(0.0, 0.0), (735000.0, 4295000.0), (635000.0, 4285000.0), (-1e6, 9e6)])
def test_a_stray_point_is_named_and_left_out(scene, tmp_path, place) -> None:
    plain = write(tmp_path / "plain.las", *scene, offset=OFFSET)
    stray = write(tmp_path / "stray.las", *np.append(scene, [[place[0]], [place[1]], [0.0]], axis=1), offset=OFFSET)
    expected = grid_clouds([plain], tmp_path / "plain.tif", void_reach=2.0, resolution=1.0, method="max")
    named = rf"stray\.las: 1 point at x {place[0]:.0f}, y {place[1]:.0f}, .* km from all others, is left out"
    with pytest.warns(UserWarning, match=named):
        found = grid_clouds([stray], tmp_path / "stray.tif", void_reach=2.0, resolution=1.0, method="max")
    np.testing.assert_array_equal(read(found), read(expected))


def test_stray_points_at_many_places_are_counted(scene, tmp_path) -> None:
    away = np.random.default_rng(1).uniform([[-1e6], [-1e6], [0]], [[1e6], [1e6], [9]], (3, 30))
    path = write(tmp_path / "stray.las", *np.append(scene, away, axis=1), offset=OFFSET)
    with pytest.warns(UserWarning, match=r"30 points at 30 places, the farthest at x"):
        assert read(grid_clouds([path], tmp_path / "o.tif", method="max")).shape == (80, 80)


def test_an_island_far_away_is_data(scene, tmp_path) -> None:
    """As dense as the rest: it is kept where the raster stays small, else refused with what can be set."""
    near = write(tmp_path / "near.las", *scene, offset=OFFSET)
    island = write(tmp_path / "island.las", *np.add(scene, [[30000.0], [9000.0], [0.0]]), offset=OFFSET)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        coarse = grid_clouds([near, island], tmp_path / "coarse.tif", resolution=5.0, method="max")
    assert read(coarse).shape == (9040 // 5, 30040 // 5)
    named = r"near\.las: 5,000 points at x 635000, .* 31\.3 km from most of .*island\.las: .*--resolution 1 or coarser"
    with pytest.raises(InputError, match=named):
        grid_clouds([near, island], tmp_path / "fine.tif", resolution=0.1, method="max")
    assert not (tmp_path / "fine.tif").exists()


def test_points_scattered_everywhere_are_refused(scene, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(survey, "_MOST_BLOCKS", 20)
    away = np.random.default_rng(1).uniform([[-1e6], [-1e6], [0]], [[1e6], [1e6], [9]], (3, 30))
    path = write(tmp_path / "scattered.las", *away)
    with pytest.raises(InputError, match=r"scattered\.las: its points are scattered .* coarsen"):
        grid_clouds([path], tmp_path / "o.tif")


@pytest.mark.parametrize("method", ["nearest", "max", "min", "mean", "idw"])
@pytest.mark.parametrize("buffers", ["buffered", "cut"])
def test_tiles_with_buffers_are_as_the_whole_cloud(tmp_path, method, buffers) -> None:
    """Points of a strip lie in both clouds, from other offsets; some points are twice in the whole cloud too."""
    random = np.random.default_rng(0)
    x, y = random.uniform(0, 60, (2, 20_000)).round(2)
    z, time = (x / 2 + random.normal(0, 1, 20_000)).round(2), np.sort(random.uniform(0, 1e6, 20_000))
    # a measurement repeated at the same place and height at another time is one of its own
    x[1::100], y[1::100], z[1::100] = x[::100], y[::100], z[::100]
    # the same point twice in one cloud
    x[2::100], y[2::100], z[2::100], time[2::100] = x[::100], y[::100], z[::100], time[::100]
    whole = write(tmp_path / "whole.las", x + 5e5, y + 5e6, z, offset=(5e5, 5e6, 0), gps_time=time)
    left, right = (x < 40.3, x >= 20.3) if buffers == "buffered" else (x < 30, x >= 30)
    parts = [
        write(tmp_path / name, x[own] + 5e5, y[own] + 5e6, z[own], offset=(5e5 + shift, 5e6, 7), gps_time=time[own])
        for name, own, shift in (("a.laz", left, 0), ("b.las", right, 20))
    ]
    options = {"method": method, "resolution": 1.0, "chunk_points": 7_001}
    expected = grid_clouds([whole], tmp_path / "whole.tif", **options)
    if buffers == "buffered" and method in ("mean", "idw"):
        shared = int((left & right).sum())
        with pytest.warns(UserWarning, match=f"^{shared:,} points that several of the clouds hold are counted once"):
            found = grid_clouds(parts, tmp_path / "parts.tif", **options)
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            found = grid_clouds(parts, tmp_path / "parts.tif", **options)
    np.testing.assert_array_equal(read(found), read(expected))


def test_each_point_is_there_as_often_as_where_it_is_most_often() -> None:
    random = np.random.default_rng(3)
    prints, clouds = random.integers(0, 30, 400).astype(np.uint64), random.integers(0, 4, 400).astype(np.uint32)
    kept = counted_once(prints, clouds)
    for each in range(30):
        assert kept[prints == each].sum() == np.bincount(clouds[prints == each]).max()
    order = random.permutation(400)
    np.testing.assert_array_equal(
        np.sort(prints[order][counted_once(prints[order], clouds[order])]), np.sort(prints[kept])
    )


def test_fingerprints_tell_fields_apart() -> None:
    place, time = np.meshgrid(np.arange(-300, 300), np.linspace(0, 1, 500))
    prints = fingerprints(place.ravel(), time.ravel())
    assert len(np.unique(prints)) == prints.size
    assert not np.isin(fingerprints(place.ravel() + 1000, time.ravel()), prints).any()


def test_copies_in_a_format_without_times_count_once(scene, tmp_path) -> None:
    x, y, z = scene
    times = np.arange(float(len(x)))
    whole = write(tmp_path / "whole.las", x, y, z, offset=OFFSET, gps_time=times)
    left, right = x < x.mean() + 5, x > x.mean() - 5
    parts = [
        write(tmp_path / "a.las", x[left], y[left], z[left], offset=OFFSET, gps_time=times[left]),
        write(tmp_path / "b.las", x[right], y[right], z[right], offset=OFFSET, kind=0),
    ]
    expected = grid_clouds([whole], tmp_path / "whole.tif", method="mean")
    with pytest.warns(UserWarning, match=f"^{int((left & right).sum()):,} points that several of the clouds hold"):
        found = grid_clouds(parts, tmp_path / "parts.tif", method="mean")
    np.testing.assert_array_equal(read(found), read(expected))


def overlapping(folder, scales, offsets, n=3000):
    """A cloud and two halves of it with a common strip, which count in steps of their own; the number in the strip."""
    random = np.random.default_rng(5)
    x, y, z = random.uniform(0, 60, n), random.uniform(0, 60, n), random.uniform(0, 9, n)
    times, both = np.arange(float(n)), (x > 20) & (x < 40)
    for name, own, scale, offset in zip(("a.las", "b.las"), (x < 40, x > 20), scales, offsets, strict=True):
        kept = {"scale": scale, "offset": (5e5 + offset, 5e6 + offset, offset), "gps_time": times[own]}
        write(folder / name, 5e5 + x[own], 5e6 + y[own], z[own], **kept)
    return [folder / "a.las", folder / "b.las"], int(both.sum())


@pytest.mark.parametrize(("scales", "offsets"), [((0.01, 0.001), (0, 0)), ((0.01, 0.01), (0, 0.005))])
def test_clouds_that_overlap_in_other_steps_are_named(tmp_path, scales, offsets) -> None:
    paths, _ = overlapping(tmp_path, scales, offsets)
    told = r"a\.las and .*b\.las overlap by 0\.12\d* ha but count coordinates in different steps: points that both hold"
    with pytest.warns(UserWarning, match=told):
        grid_clouds(paths, tmp_path / "o.tif", method="mean", resolution=1.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        grid_clouds(paths, tmp_path / "nearest.tif", resolution=1.0)


@pytest.mark.parametrize("half", [0.0, 0.005])
def test_copies_from_other_offsets_are_told_beside_a_coarse_cloud(tmp_path, half) -> None:
    """Values in the middle between two coarse steps, which rounding might take to either side."""
    paths, shared = overlapping(tmp_path, (0.001, 0.001), (half, half + 17.0))
    far = write(tmp_path / "c.las", [5e5 + 100], [5e6 + 100], [1.0], scale=0.01, gps_time=[0.0])
    with pytest.warns(UserWarning, match=f"^{shared:,} points that several of the clouds hold are counted once"):
        grid_clouds([*paths, far], tmp_path / "o.tif", method="mean", resolution=1.0)
