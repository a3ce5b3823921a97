"""The layers of a city, each computed from the scene of a window."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.synthetic.city import City, layout_of
from tilepipe_kernels.city.ground import MARKING, STREET, lay_terrain
from tilepipe_kernels.city.intensity import object_intensities, speckle_table, speckled
from tilepipe_kernels.city.layout import Layout, Window
from tilepipe_kernels.city.noise import texture, white
from tilepipe_kernels.city.objects import TREE
from tilepipe_kernels.city.photograph import margin, photograph
from tilepipe_kernels.city.scene import Scene, scene
from tilepipe_kernels.city.voids import find_voids

FINE_STREAM, COARSE_STREAM, ROUGHNESS_STREAM, GRAIN_STREAM = 61, 62, 64, 65
FINE_MESH, COARSE_MESH = 3.5, 40.0
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

    Examples
    --------
    Any window holds the same pixels, whatever else is rendered.

    >>> from tilepipe.synthetic import City, render
    >>> city = City(seed=7, rows=256, columns=256)
    >>> streets = render(city, "streets")
    >>> streets.shape, bool(0.05 < streets.mean() < 0.5)
    ((256, 256), True)
    >>> bool((render(city, "streets", (100, 50, 20, 30)) == streets[100:120, 50:80]).all())
    True
    """
    return render_layers(city, (layer,), window)[layer]


def render_layers(city: City, layers: Sequence[str], window: Window | None = None) -> dict[str, NDArray[Any]]:
    """Several layers of a window, as ``render`` gives them, from one scene.

    Examples
    --------
    >>> from tilepipe.synthetic import City, render_layers
    >>> layers = render_layers(City(rows=128, columns=128), ["height", "aerial"])
    >>> {name: (layer.shape, layer.dtype.name) for name, layer in layers.items()}
    {'height': ((128, 128), 'float32'), 'aerial': ((3, 128, 128), 'uint8')}
    """
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
    tones, quantiles = object_intensities(found.objects), speckle_table(view.city.speckle)
    return speckled(
        view.layout, view.window, found.ground, found.visible, tones, view.fine, view.coarse, view.voids, quantiles
    )


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


def _aerial(view: View) -> NDArray[np.uint8]:
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
