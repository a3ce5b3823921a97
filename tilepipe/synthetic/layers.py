"""The layers of a city, each computed from the scene of a window."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.synthetic.city import City, Layout, layout_of
from tilepipe.synthetic.ground import MARKING, STREET, lay_terrain
from tilepipe.synthetic.hashing import HIGH_BITS, bits, mixed
from tilepipe.synthetic.objects import CAR, TREE
from tilepipe.synthetic.photograph import photograph
from tilepipe.synthetic.scene import Scene, Window, find_voids, scene, texture
from tilepipe_kernels.core.compiled import loop

FINE_STREAM, COARSE_STREAM, SPECKLE_STREAM, ROUGHNESS_STREAM, GRAIN_STREAM = 61, 62, 63, 64, 65
FINE_MESH, COARSE_MESH = 3.5, 40.0
#: Mean intensity of grass, meadow, concrete, pavement, street and marking, and how far texture moves it.
GROUND_INTENSITY = np.array([150, 158, 116, 96, 45, 90], np.float32)
GROUND_TEXTURE = np.array([16, 20, 8, 6, 4, 4], np.float32)
TREE_INTENSITY, CAR_INTENSITY = np.float32(132), np.float32(205)
ROOF_DARKEST, ROOF_RANGE = 68.0, 140.0
SPECKLE_STEPS = 4096
LARGEST = np.float32(255)
ROUGHNESS = {"ground": np.float32(0.03), "tree": np.float32(0.45)}
#: Bits of the layer ``edges``: a boundary towards the pixel below, towards the pixel to the right.
EDGE_BELOW, EDGE_RIGHT = 1, 2


@dataclass(frozen=True)
class View:
    """A city's window with what several layers share, computed when first asked for."""

    city: City
    window: Window

    @property
    def layout(self) -> Layout:
        """The city's layout."""
        return layout_of(self.city)

    @cached_property
    def scene(self) -> Scene:
        """What covers the window."""
        return scene(self.layout, self.window)

    @cached_property
    def voids(self) -> NDArray[np.bool_]:
        """Pixels without a return."""
        return find_voids(self.layout, self.window)

    @cached_property
    def fine(self) -> NDArray[np.float32]:
        """Texture of a few metres."""
        return texture(self.layout, self.window, FINE_MESH, FINE_STREAM)

    @cached_property
    def coarse(self) -> NDArray[np.float32]:
        """Texture of tens of metres."""
        return texture(self.layout, self.window, COARSE_MESH, COARSE_STREAM)

    def grown(self, margin: int) -> View:
        """The view of the window with a margin around it."""
        row, column, rows, columns = self.window
        return View(self.city, (row - margin, column - margin, rows + 2 * margin, columns + 2 * margin))


def render(city: City, layer: str, window: Window | None = None) -> NDArray[Any]:
    """One layer of a window of a city; the same pixels whatever the window.

    Parameters
    ----------
    city
        The city.
    layer
        One of ``LAYERS``: ``height`` (float32, m, NaN where void), ``intensity`` (uint8, 0 where void, else 1
        to 255), ``aerial`` (uint8, red, green and blue), ``streets`` (uint8, 1 on streets, also where
        hidden), ``buildings`` (int32, id of the footprint or 0), ``edges`` (uint8, sum of 1 for a boundary of
        the photograph towards the pixel below and 2 for one to the right), ``trees`` (uint8, 1 where a crown
        is seen).
    window
        First row, first column, rows and columns; the whole city when None. It may reach over the city's
        border.

    Returns
    -------
    ndarray
        Shape (rows, columns), for ``aerial`` (3, rows, columns).

    Raises
    ------
    InputError
        When the layer is unknown or the window is empty.
    """
    return render_layers(city, (layer,), window)[layer]


def render_layers(city: City, layers: Sequence[str], window: Window | None = None) -> dict[str, NDArray[Any]]:
    """Several layers of a window, as ``render`` gives them, from one scene."""
    for layer in layers:
        if layer not in LAYERS:
            raise InputError(f"unknown layer {layer!r}; choose from {', '.join(LAYERS)}")
    window = (0, 0, *city.shape) if window is None else window
    if min(window[2:]) < 1:
        raise InputError(f"window {window} is empty; give first row, first column, rows and columns")
    view = View(city, tuple(int(n) for n in window))  # type: ignore[arg-type]
    return {layer: LAYERS[layer](view) for layer in layers}


def _intensity(view: View) -> NDArray[np.uint8]:
    found = view.scene
    tones = np.where(
        found.objects["kind"] == TREE,
        TREE_INTENSITY + 30 * (found.objects["tone"] - 0.5),
        np.where(
            found.objects["kind"] == CAR,
            CAR_INTENSITY + 60 * (found.objects["tone"] - 0.5),
            ROOF_DARKEST + ROOF_RANGE * found.objects["tone"],
        ),
    ).astype(np.float32)
    return speckled(
        view.layout, view.window, found.ground, found.visible, tones, view.fine, view.coarse, view.voids,
        speckle_table(view.city.speckle),
    )  # fmt: skip


@lru_cache(maxsize=8)
def speckle_table(deviation: float) -> NDArray[np.float32]:
    """Quantiles of gamma-distributed speckle of mean 1 and the given standard deviation."""
    if deviation == 0:
        return np.ones(SPECKLE_STEPS, np.float32)
    from scipy.special import gammaincinv

    shape = 1 / deviation**2
    quantiles = gammaincinv(shape, (np.arange(SPECKLE_STEPS) + 0.5) / SPECKLE_STEPS) / shape
    return np.asarray(quantiles, np.float32)


@loop
def speckled(
    layout: Layout, window: Window, ground: NDArray[np.uint8], visible: NDArray[np.int32],
    tones: NDArray[np.float32], fine: NDArray[np.float32], coarse: NDArray[np.float32],
    voids: NDArray[np.bool_], quantiles: NDArray[np.float32],
) -> NDArray[np.uint8]:  # fmt: skip
    """Lidar intensity: the mean of what is seen, its texture, and multiplicative speckle; 0 where void."""
    row, column, rows, columns = window
    result = np.empty((rows, columns), np.uint8)
    half = np.float32(0.5)
    for r in range(rows):
        key = bits(layout.key, SPECKLE_STREAM, row + r, 0)
        for c in range(columns):
            item, kind = visible[r, c], ground[r, c]
            natural = (fine[r, c] + coarse[r, c]) * half
            mean = tones[item] * (np.float32(1) + np.float32(0.06) * natural)
            if item < 0:
                mean = GROUND_INTENSITY[kind] + GROUND_TEXTURE[kind] * natural
            place = np.int64(mixed(key ^ np.uint64(column + c)) >> np.uint64(52))
            value = min(max(mean * quantiles[place] + half, np.float32(1)), LARGEST)
            result[r, c] = np.uint8(0) if voids[r, c] else np.uint8(value)
    return result


def surface(view: View) -> NDArray[np.float32]:
    """Height of the highest surface in metres without voids or noise."""
    return np.maximum(lay_terrain(view.layout, *view.window), view.scene.top)


def _height(view: View) -> NDArray[np.float32]:
    found = view.scene
    trees = np.append(found.objects["kind"] == TREE, False)
    result = surface(view)
    rough = np.where(trees[found.visible], ROUGHNESS["tree"], ROUGHNESS["ground"])
    result += rough * white(view.layout, view.window, ROUGHNESS_STREAM)
    result[view.voids] = np.nan
    return result


@loop
def white(layout: Layout, window: Window, stream: int) -> NDArray[np.float32]:
    """White noise of a bell shape, mean 0 and standard deviation 1: the sum of four draws of 13 bits."""
    row, column, rows, columns = window
    result = np.empty((rows, columns), np.float32)
    scale = np.float32(np.sqrt(3.0) / 8192)
    for r in range(rows):
        key = bits(layout.key, stream, row + r, 0)
        for c in range(columns):
            draw = mixed(key ^ np.uint64(column + c)) >> HIGH_BITS
            total = (draw & np.uint64(8191)) + ((draw >> np.uint64(13)) & np.uint64(8191))
            total += ((draw >> np.uint64(26)) & np.uint64(8191)) + ((draw >> np.uint64(39)) & np.uint64(8191))
            result[r, c] = np.float32(np.int64(total) - 16382) * scale
    return result


def _aerial(view: View) -> NDArray[np.uint8]:
    from tilepipe.synthetic.photograph import margin

    wide = view.grown(margin(view.city.resolution))
    noise = white(view.layout, view.window, GRAIN_STREAM)
    return photograph(view.city.resolution, wide.scene, surface(wide), wide.fine, wide.coarse, noise)


def _streets(view: View) -> NDArray[np.uint8]:
    ground = view.scene.ground
    return np.asarray((ground == STREET) | (ground == MARKING), np.uint8)


def _buildings(view: View) -> NDArray[np.int32]:
    ids = np.append(view.scene.objects["building"], 0).astype(np.int32)
    return ids[view.scene.footprint]


def _trees(view: View) -> NDArray[np.uint8]:
    return _tree_mask(view.scene).astype(np.uint8)


def _tree_mask(found: Scene) -> NDArray[np.bool_]:
    is_tree: NDArray[np.bool_] = np.append(found.objects["kind"] == TREE, False)
    return is_tree[found.visible]


def _edges(view: View) -> NDArray[np.uint8]:
    """Outlines of buildings and borders of streets where no tree hides either side."""
    row, column, rows, columns = view.window
    wide = View(view.city, (row, column, rows + 1, columns + 1))
    # A label per building, -1 for streets and 0 for the rest: an edge is where the label changes.
    label = np.where(_streets(wide) == 1, np.int32(-1), _buildings(wide))
    open_sky = ~_tree_mask(wide.scene)
    below = (label[:-1, :-1] != label[1:, :-1]) & open_sky[:-1, :-1] & open_sky[1:, :-1]
    right = (label[:-1, :-1] != label[:-1, 1:]) & open_sky[:-1, :-1] & open_sky[:-1, 1:]
    edges: NDArray[np.uint8] = EDGE_BELOW * below.astype(np.uint8) + EDGE_RIGHT * right.astype(np.uint8)
    return edges


#: How each layer is computed from a view.
LAYERS: dict[str, Callable[[View], NDArray[Any]]] = {
    "height": _height,
    "intensity": _intensity,
    "aerial": _aerial,
    "streets": _streets,
    "buildings": _buildings,
    "edges": _edges,
    "trees": _trees,
}
