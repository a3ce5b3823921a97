"""A halo is as wide as what its pass sees: with a wider one a tile leaves the same, and half of it is too little.

The scenes make each pass look as far as it can, so that a halo that is too narrow shows.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.scenes import write_raster
from tilepipe.engine.options import RunOptions
from tilepipe.engine.tiles import passes
from tilepipe.engine.work import run_pipeline
from tilepipe.errors import InputError
from tilepipe.pipelines import registry
from tilepipe.pipelines.streets import pass_segment
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile

pytestmark = [
    pytest.mark.filterwarnings(f"ignore:.*{warning}")
    for warning in ("still wanted to change", "has no line", "has not converged")
]


@dataclass
class Seen:
    """Of a pass: its halo, and the tiles that left something else with half of it, and with more than it."""

    halo: int = 0
    half: set[int] = field(default_factory=set)
    wide: set[int] = field(default_factory=set)


def left_by(bound: passes.BoundPass, tile: Tile) -> Facts | None:
    """What a tile leaves, the checksums of its state among it; None where that cannot be computed."""
    with suppress(Exception):
        return passes._facts_on_host(bound, tile)
    return None


def left_with(bound: passes.BoundPass, tile: Tile, halo: int) -> Facts | None:
    """What a tile leaves with another halo."""
    # heights are read in a window of their own
    with patch.object(pass_segment, "ground_reach", lambda *_: halo):
        return left_by(bound, bound.grid.tile(tile.number, halo))


def same(a: Facts | None, b: Facts | None) -> bool:
    if a is None or b is None or a.keys() != b.keys():
        return False
    return all(a[name].dtype == b[name].dtype and a[name].tobytes() == b[name].tobytes() for name in a)


@contextmanager
def other_halos() -> Iterator[dict[str, Seen]]:
    """Compute each tile with half of its halo and with twice the halo as well."""
    seen: dict[str, Seen] = defaultdict(Seen)
    run_tile = passes._run_tile

    def compared(bound: passes.BoundPass, folder: Path, tile: Tile) -> int:
        halo, found = bound.halo, seen[bound.name]
        narrow, wide = (left_with(bound, tile, width) for width in (halo // 2, 2 * halo + 9))
        declared = left_by(bound, tile)
        found.halo = halo
        if not same(narrow, declared):
            found.half.add(tile.number)
        if not same(wide, declared):
            found.wide.add(tile.number)
        return run_tile(bound, folder, tile)

    with patch.object(passes, "_run_tile", compared):
        yield seen


def strips(length: int) -> NDArray[np.float32]:
    """A dark place cut into narrow strips by bright lines of one pixel, as long as a speck may be, or a pixel more.

    Whether such a line is filled is decided at its far end.
    """
    values = np.full((96, 5 * length), 200, np.float32)
    values[8:88] = 40
    for row in range(12, 84, 4):
        start = 7 + (row * 11) % length
        while start + length + 1 < values.shape[1] - 4:
            values[row, start : start + length + (row // 4 + start) % 2] = 200
            start += length + 9
    return values


def noise(side: int, low: float, high: float, seed: int = 0) -> NDArray[np.float32]:
    return np.random.default_rng(seed).uniform(low, high, (side, side)).astype(np.float32)


def blots(side: int = 96) -> NDArray[np.float32]:
    """Smooth noise: dark and bright places of all widths, with edges of all slopes."""
    from scipy import ndimage

    smooth = ndimage.gaussian_filter(noise(side, -1, 1), 3)
    return (120 + 60 * np.tanh(20 * smooth) + noise(side, -5, 5, 1)).astype(np.float32)


def pits(side: int, width: int, seed: int = 3) -> NDArray[np.float32]:
    """A plain with so few pits that a square of some width may hold none: a single one decides for all around it."""
    random = np.random.default_rng(seed)
    return np.where(random.random((side, side)) < 4 / width**2, 0, 10).astype(np.float32)


def row_of_pits() -> NDArray[np.float32]:
    """A plain with pits in one row, of two pixels each way since a single one counts as stray.

    Where squares just fit between two pits the ground is high; whether one does is decided at the farther pit.
    """
    values = np.full((48, 360), 10, np.float32)
    for column in (30, 150, 210):
        values[20:22, column : column + 2] = 0
    return values


STREETS = {
    "diffusion_steps": 0, "void_reach": 0, "darkness": 100, "minimum_size": 0, "minimum_contour": 0,
    "minimum_elongation": 0, "maximum_mean_width": 500, "closing_radius": 0, "opening_radius": 0, "line_width": 2,
    "minimum_street_width": 1, "maximum_width": 4, "minimum_length": 0, "minimum_branch": 0, "maximum_gap": 0,
}  # fmt: skip
SPECK = 48

SCENES: dict[str, tuple[str, Callable[[], NDArray[np.float32]], dict[str, Any], int]] = {
    "specks": ("streets", lambda: strips(SPECK), STREETS | {"speck_size": SPECK, "thresholds": "histogram"}, 40),
    "diffusion": ("streets", blots, STREETS | {"diffusion_steps": 4, "gradient_sigma": 1.0, "speck_size": 0}, 24),
    "ground": ("streets", blots, STREETS | {"speck_size": 0, "ground_window": 24}, 24),
    "roofs": ("objects", lambda: pits(160, 42), {"largest_building": 40, "largest_leaf": 8.0}, 40),
    "plain": ("objects", row_of_pits, {"largest_building": 120, "largest_leaf": 8.0}, 40),
    "levels": ("edges", blots, {"levels": 3, "rounds": 2, "smoothness": 3.0}, 24),
    "integrated": (
        "edges",
        lambda: noise(80, 0, 255),
        {"levels": 2, "rounds": 1, "scheme": "integrated", "smoothness": 4.0},
        20,
    ),
    "annealing": (
        "edges",
        lambda: noise(60, 0, 255),
        {"levels": 2, "rounds": 1, "optimiser": "annealing", "sweeps": 2, "smoothness": 6.0},
        20,
    ),
    "messages": (
        "edges",
        lambda: noise(100, 0, 255),
        {"levels": 2, "rounds": 1, "optimiser": "messages", "smoothness": 6.0},
        24,
    ),
}
"""Pipeline, raster, parameters and tile of scenes that make passes look far."""


@pytest.fixture(scope="module", params=SCENES)
def scene(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, dict[str, Seen]]:
    """A scene, and what its passes leave with other halos."""
    name, values, parameters, tile = SCENES[request.param]
    folder = tmp_path_factory.mktemp(request.param)
    raster = write_raster(folder / "raster.tif", values())
    inputs = {}
    if request.param == "ground":
        inputs["heights"] = write_raster(folder / "heights.tif", pits(96, 25))
    options = RunOptions(tile=tile, workers=1)
    with other_halos() as seen, suppress(InputError):
        run_pipeline(
            registry.pipeline(name), [raster], folder / "run", inputs=inputs, params=parameters, options=options
        )
    return request.param, seen


NOTICED = {
    "specks": {"levels", "responses", "lines"},
    "diffusion": {"levels", "segment"},
    "ground": {"levels", "segment"},
    "roofs": {"borders"},
    "plain": {"leaves", "borders"},
    **{name: {"levels", "fields"} for name in ("levels", "integrated", "annealing", "messages")},
}
"""Passes of the scenes of which half the halo is too little there."""


def test_a_wider_halo_changes_nothing(scene: tuple[str, dict[str, Seen]]) -> None:
    _, seen = scene
    assert {name: sorted(found.wide) for name, found in seen.items() if found.wide} == {}


def test_half_a_halo_is_noticed(scene: tuple[str, dict[str, Seen]]) -> None:
    name, seen = scene
    assert NOTICED[name] <= {key for key, found in seen.items() if found.half}
