"""Which points of a chunk count, what tells them from others, and chunks that end too soon."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.io.clouds.test_cloud import write
from tilepipe.errors import InputError
from tilepipe.io.clouds import points
from tilepipe.io.clouds.cloud import read_cloud
from tilepipe.io.clouds.points import IDENTITY, PointFilter, identities, read_points, ticks


def chunk(**fields: Any) -> Any:
    return SimpleNamespace(**{name: np.array(values) for name, values in fields.items()})


@pytest.mark.parametrize(
    ("wanted", "kept"),
    [
        (PointFilter(), [0, 1, 2, 3, 4]),
        (PointFilter(returns="first"), [0, 1, 3]),
        (PointFilter(returns="last"), [0, 1, 4]),
        (PointFilter(classes=(7,)), [5]),
        (PointFilter(classes=(2, 6), returns="last"), [0, 4]),
        (PointFilter(classes=()), []),
    ],
)
def test_points_that_count(wanted, kept):
    found = wanted.keep(
        chunk(
            classification=[2, 1, 6, 2, 6, 7, 18, 2],
            withheld=[0, 0, 0, 0, 0, 0, 0, 1],
            # the first writer knows no returns; then the only one, the second of three, the first and last of two
            return_number=[0, 1, 2, 1, 2, 1, 1, 1],
            number_of_returns=[0, 1, 3, 2, 2, 1, 1, 1],
        )
    )
    assert np.flatnonzero(found).tolist() == kept


def test_a_cloud_is_read_in_chunks_to_its_last_point(tmp_path):
    cloud = read_cloud(write(tmp_path / "a.las", np.arange(10), np.arange(10), [1] * 10, classification=[2] * 9 + [7]))
    found = list(read_points(cloud, IDENTITY, PointFilter(), 4, parallel=False))
    assert [count for count, _ in found] == [4, 4, 2]
    assert [len(each) for _, each in found] == [4, 4, 1]


@pytest.mark.parametrize("left", [10, 7])
def test_a_cloud_that_ends_too_soon_says_how_much_is_missing(tmp_path, monkeypatch, left):
    cloud = read_cloud(write(tmp_path / "a.las", np.arange(10), np.arange(10), [1] * 10))
    many = SimpleNamespace(points=10 + left, path=cloud.path, files=cloud.files)
    with pytest.raises(InputError, match=rf"a\.las: cut off {left} points before its end"):
        list(read_points(many, IDENTITY, PointFilter(), 1000, parallel=False))  # type: ignore[arg-type]


def cloud_of(scale: float = 0.01, offset: float = 0.0, has_times: bool = True) -> Any:
    return SimpleNamespace(scales=(scale,) * 3, offsets=(offset,) * 3, has_times=has_times)


def at(place: float, cloud: Any, **fields: Any) -> Any:
    raw = round((place - cloud.offsets[0]) / cloud.scales[0])
    usual = {"X": [raw], "Y": [raw], "Z": [raw], "return_number": [1], "intensity": [9], "gps_time": [5.0]}
    return chunk(**usual | fields)


def test_copies_of_a_point_share_what_tells_it_from_others():
    plain, fine, moved = cloud_of(), cloud_of(0.001), cloud_of(offset=100.0)
    clouds = [plain, fine, moved]
    first = identities(plain, at(123.45, plain), clouds)
    for cloud in clouds:
        assert identities(cloud, at(123.45, cloud), clouds) == first
        assert identities(cloud, at(123.46, cloud), clouds) != first
        for name in ("X", "Y", "Z"):
            there = at(123.45, cloud)
            setattr(there, name, getattr(there, name) + round(0.01 / cloud.scales[0]))
            assert identities(cloud, there, clouds) != first, name
    for other in ({"return_number": [2]}, {"intensity": [8]}, {"gps_time": [5.5]}):
        assert identities(plain, at(123.45, plain, **other), clouds) != first
    # a copy without times is still one
    without = [plain, cloud_of(has_times=False)]
    assert identities(plain, at(1.0, plain, gps_time=[7.0]), without) == identities(plain, at(1.0, plain), without)
    # a time of zero has two signs
    zeros = [identities(plain, at(1.0, plain, gps_time=[zero]), clouds) for zero in (0.0, -0.0)]
    assert zeros[0] == zeros[1]


@pytest.mark.parametrize(("quantum", "expected"), [(0.001, [2340, -1660]), (0.5, [5, -3])])
def test_values_in_ticks(quantum, expected):
    cloud = SimpleNamespace(scales=(1, 1, 0.01), offsets=(0, 0, 2.0))
    some = chunk(Z=[34, -366], intensity=[7, 65535])
    assert ticks(cloud, some, "height", quantum).tolist() == expected  # type: ignore[arg-type]
    assert ticks(cloud, some, "intensity", quantum).tolist() == [7, 65535]  # type: ignore[arg-type]
    assert points.NOISE_CLASSES == (7, 18)
