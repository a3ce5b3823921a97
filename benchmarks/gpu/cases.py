"""What `benchmarks.gpu.check` compares: each kernel of the three pipelines, on numpy and on cupy arrays.

Nothing here needs more than numpy and the kernels, since a GPU machine may have no more.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.car_model import sampler
from tilepipe_kernels.heights import ground, surface_shape
from tilepipe_kernels.image import diffusion, distance, fill, grey_levels, morphology
from tilepipe_kernels.mrf import edge_model
from tilepipe_kernels.mrf.labels.intensity_field import intensity_field
from tilepipe_kernels.mrf.lines.minimise import line_field
from tilepipe_kernels.mrf.search import Method, Search
from tilepipe_kernels.network import skeleton
from tilepipe_kernels.nevatia_babu.links import find_elements
from tilepipe_kernels.regions import adjacency, extremes, growing, quadtree, region_table
from tilepipe_kernels.ridges.links import link_points
from tilepipe_kernels.ridges.points import line_points

Arrays = tuple[Any, ...]
Image = NDArray[np.float32]


@dataclass(frozen=True)
class GpuCase:
    """One kernel.

    Attributes
    ----------
    name
        As in the table.
    make
        Inputs on the host for a square of so many pixels a side.
    run
        Calls the kernel; works on arrays of either kind.
    traffic
        Bytes per pixel of all arrays that it must read or write, each counted once, for one step or round.
    steps
        Steps or rounds of one call; the rate counts pixels of each.
    tolerance
        Largest difference from the CPU's result; 0 = the very same.
    unit
        What is counted: pixels, or node updates.
    """

    name: str
    make: Callable[[int], Arrays]
    run: Callable[..., Any]
    traffic: float
    steps: int = 1
    tolerance: float = 0.0
    unit: str = "px"


# ------------------------------------------------------------------------------------------------- scenes


def grey(size: int) -> Image:
    """Dark streets on bright, noisy ground, 0–255."""
    rows, columns = np.mgrid[:size, :size].astype(np.float32)
    # two streets cross near the origin, so that small squares show something too
    street = np.abs((rows + 0.3 * columns + 65) % 160 - 80) < 7
    street |= np.abs((columns - 0.2 * rows + 105) % 230 - 115) < 6
    noise = np.random.default_rng(size).normal(0, 6, (size, size)).astype(np.float32)
    return np.clip(np.where(street, np.float32(90), np.float32(180)) + noise, 0, 255)


def mask(size: int) -> NDArray[np.bool_]:
    """The streets alone."""
    return grey(size) < 135


def specked(size: int) -> NDArray[np.bool_]:
    """The streets with holes, and what is no street beside them."""
    return mask(size) ^ (np.random.default_rng(size + 1).random((size, size)) < 0.02)


def heights(size: int) -> NDArray[np.int32]:
    """Ground that rises, flat and sloped roofs, noise; millimetres."""
    rows, columns = np.mgrid[:size, :size]
    roof = (rows % 60 < 34) & (columns % 75 < 40)
    slope = np.where(rows // 60 % 2, 0, np.abs(rows % 60 - 17) * 120)
    noise = np.random.default_rng(size).integers(-40, 40, (size, size))
    return (rows * 3 + columns + roof * (6000 - slope) + noise).astype(np.int32)


def metres(size: int) -> Image:
    """The same in metres."""
    return heights(size).astype(np.float32) / np.float32(1000)


def levels(size: int) -> Image:
    """Two grey levels with noise, in units of a level."""
    return (grey(size) - np.float32(90)) / np.float32(90)


def leaves(size: int) -> tuple[Any, int]:
    """Labels of the quadtree's leaves and their number."""
    labels, table = split(heights(size))
    return labels, int(table.first.size)


def graph_of_grid(side: int) -> Any:
    """A grid of nodes as a region graph: as many nodes as pixels."""
    index = np.arange(side * side).reshape(side, side)
    edges = np.concatenate(
        [
            np.stack([index[:, :-1].ravel(), index[:, 1:].ravel()], 1),
            np.stack([index[:-1].ravel(), index[1:].ravel()], 1),
        ]
    )
    edges = edges[np.lexsort(edges.T[::-1])].astype(np.int32)
    rng = np.random.default_rng(side)
    count = rng.integers(1, 50, index.size).astype(np.float64)
    mean = rng.normal(10, 3, index.size)
    return edges, count, mean, count * 0.1


# ------------------------------------------------------------------------------------------------- calls

SWEEPS, STEPS, ROUNDS = 20, 20, 24
MODEL = edge_model.EdgeModel()


def split(ticks: Any) -> Any:
    """Quadtree of heights: squares of 2 to 32 pixels whose heights deviate by 0.3 m at most."""
    return quadtree.split(ticks, threshold=300.0**2, smallest=2, largest=32)


def _diffuse(image: Any) -> Any:
    return diffusion.diffuse(image, steps=STEPS, time_step=0.25, conductance=0.01)


def _line_points(image: Any) -> Any:
    return line_points(image, 4.0, low=0.5)


def _linked(image: Any) -> Any:
    return link_points(line_points(image, 4.0, low=0.5))


def _table(labels: Any, values: Any) -> Any:
    return region_table.region_table(labels, values, int(labels.max()))


def _sweeps(edges: Any, count: Any, mean: Any, spread: Any) -> Any:
    model = sampler.CarModel(edges, None, count, mean, spread)
    return sampler.sample_variances(model, burn_in=SWEEPS // 2, draws=SWEEPS // 2, thinning=1, seed=1)


def _with_voids(size: int) -> Image:
    return np.where(mask(size), np.float32(np.nan), grey(size))


def _labelled_streets(size: int) -> Arrays:
    return growing.grow_regions(grey(size), 12, maximum=135), grey(size)


def _leaves_and_heights(size: int) -> Arrays:
    labels, count = leaves(size)
    return labels, heights(size), count


def _ground(h: Any) -> Any:
    return ground.ground_height(h, resolution=0.5, largest_object=30.0)


def _label(method: Method) -> Callable[[Any], Any]:
    return lambda y: intensity_field(y, MODEL, search=Search(method, ROUNDS)).labels


def _line_field(x: Any) -> Any:
    return line_field(x, MODEL, search=Search(rounds=ROUNDS)).horizontal


def _labels(size: int) -> Arrays:
    return (intensity_field(levels(size), MODEL).labels,)


def _one(make: Callable[[int], Any]) -> Callable[[int], Arrays]:
    return lambda size: (make(size),)


def street_cases() -> list[GpuCase]:
    """Kernels of `streets`."""
    return [
        GpuCase("diffusion, 20 steps", _one(grey), _diffuse, 12, STEPS),
        GpuCase("voids", _one(_with_voids), lambda v: fill.fill_voids(v, 4), 8),
        GpuCase("regions", _one(grey), lambda v: growing.grow_regions(v, 12, maximum=135), 8),
        GpuCase("region table", _labelled_streets, _table, 8),
        GpuCase("grey levels", _one(grey), lambda v: grey_levels.stretch(v, 5.0, 250.0), 8),
        GpuCase("opening of a mask", _one(specked), lambda m: morphology.open_mask(m, 3.0), 2),
        GpuCase("specks", _one(specked), lambda m: morphology.fill_specks(m, 8), 2),
        GpuCase("nearest background", _one(mask), lambda m: distance.nearest_background(m, 20), 9),
        GpuCase("skeleton", _one(mask), lambda m: skeleton.medial_axis(m, cap=20), 2),
        GpuCase("line points (Hessian)", _one(grey), _line_points, 4, tolerance=1e-4),
        GpuCase("linked line points", _one(grey), _linked, 4),
    ]


def object_cases() -> list[GpuCase]:
    """Kernels of `objects`."""
    return [
        GpuCase("quadtree", _one(heights), split, 8),
        GpuCase("contacts of leaves", leaves, adjacency.contacts, 4),
        GpuCase("heights of leaves", _leaves_and_heights, extremes.label_extremes, 8),
        GpuCase("ground", _one(metres), _ground, 8, tolerance=1e-3),
        GpuCase(
            "shape of the surface",
            _one(heights),
            lambda t: surface_shape.surface_shape(t, half_width=3),
            12,
            tolerance=1e-4,
        ),
        GpuCase("Gibbs on a graph, 20 sweeps", graph_of_grid, _sweeps, 72, SWEEPS, 1e-6, "node updates"),
    ]


def edge_cases() -> list[GpuCase]:
    """Kernels of `edges`."""
    return [
        GpuCase("labels, parallel HCF", _one(levels), _label("parallel"), 5, ROUNDS),
        GpuCase("labels, messages", _one(levels), _label("messages"), 36, ROUNDS),
        GpuCase("line field, parallel HCF", _labels, _line_field, 3, ROUNDS),
        GpuCase("Nevatia-Babu elements", _one(grey), lambda v: find_elements(v, 20000.0), 4),
    ]


def cases() -> list[GpuCase]:
    """All kernels, by pipeline."""
    return [*street_cases(), *object_cases(), *edge_cases()]
