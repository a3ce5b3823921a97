"""The kernels of `objects` beside what a user would pick instead: quadtree, contacts, sampler, polygons."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.kernels.scene import Band, Scene, over_bands
from benchmarks.measure.contest import Call, Case, Contestant
from tilepipe.io.vectors.geometries import region_polygons
from tilepipe.pipelines.objects.pass_leaves import to_ticks
from tilepipe.synthetic import City, render
from tilepipe_kernels.car_model.model import CarModel
from tilepipe_kernels.car_model.sampler import sample
from tilepipe_kernels.polylines.arcs import trace_arcs
from tilepipe_kernels.polylines.join import join_arcs
from tilepipe_kernels.polylines.polygons import assemble_polygons
from tilepipe_kernels.polylines.simplify import simplify_polylines
from tilepipe_kernels.regions import adjacency, quadtree

DEVIATION = 350.0
"""σ0 in ticks of a millimetre."""
SMALLEST, LARGEST = 2, 64
SWEEPS = 20


@cache
def _ticks(size: int) -> NDArray[np.int32]:
    return to_ticks(render(City(rows=size, columns=size), "height").astype(np.float32), 1.0)[0]


@cache
def city_leaves(size: int) -> tuple[NDArray[np.int32], quadtree.LeafTable]:
    """Labels and leaves of a city of ``size`` pixels a side."""
    return quadtree.split(_ticks(size), threshold=DEVIATION**2, smallest=SMALLEST, largest=LARGEST)


def quadtree_case(scene: Scene) -> Case:
    """Heights to leaves: four bytes in, four out."""
    return Case(
        "quadtree",
        "Mpx/s",
        scene.megapixels,
        8 * scene.size**2,
        [
            Contestant("tilepipe split", lambda: _split(scene), ours=True),
            Contestant("NumPy pyramid", lambda: _numpy_split(scene), serial=True, note="no nodata"),
        ],
        aim=100,
    )


def _split(scene: Scene) -> Call:
    ticks = _ticks(scene.size)

    def part(band: Band) -> Any:
        block = ticks[band.start : band.stop]
        return quadtree.split(block, threshold=DEVIATION**2, smallest=SMALLEST, largest=LARGEST)

    return lambda workers: over_bands(part, scene.size, 0, workers)


def _numpy_split(scene: Scene) -> Call:
    heights = _ticks(scene.size).astype(np.float64)

    def run(workers: int) -> Any:
        sums, squares, counts = [heights], [heights**2], [1]
        while counts[-1] < LARGEST**2:
            for pyramid in (sums, squares):
                a = pyramid[-1]
                pyramid.append(a[::2, ::2] + a[1::2, ::2] + a[::2, 1::2] + a[1::2, 1::2])
            counts.append(4 * counts[-1])
        labels, found = np.zeros(heights.shape, np.int32), 0
        undecided = np.ones(sums[-1].shape, np.bool_)
        for level in range(len(counts) - 1, SMALLEST.bit_length() - 2, -1):
            variance = squares[level] / counts[level] - (sums[level] / counts[level]) ** 2
            leaf = undecided & ((variance <= DEVIATION**2) | (1 << level <= SMALLEST))
            number = np.zeros(leaf.shape, np.int32)
            number[leaf] = np.arange(found + 1, found + 1 + np.count_nonzero(leaf))
            found += int(np.count_nonzero(leaf))
            labels += number.repeat(1 << level, 0).repeat(1 << level, 1)
            undecided = (undecided & ~leaf).repeat(2, 0).repeat(2, 1)
        return labels

    return run


def contacts_case(scene: Scene) -> Case:
    """Leaves to edges with border lengths; what is made of a pixel is far less than its label."""
    return Case(
        "region adjacency",
        "Mpx/s",
        scene.megapixels,
        4 * scene.size**2,
        [
            Contestant("tilepipe contacts", lambda: _contacts(scene), ours=True, note="seams are joined by facts"),
            Contestant("NumPy unique", lambda: _numpy_contacts(scene), serial=True),
        ],
        aim=60,
    )


def _contacts(scene: Scene) -> Call:
    labels, leaves = city_leaves(scene.size)
    count = leaves.first.size

    def part(band: Band) -> Any:
        block = labels[band.start : band.stop]
        low = max(int(block.min()), 1)
        return adjacency.contacts(np.maximum(block - (low - 1), 0), min(count, int(block.max())) - low + 1)

    return lambda workers: over_bands(part, scene.size, 0, workers)


def _numpy_contacts(scene: Scene) -> Call:
    labels = city_leaves(scene.size)[0].astype(np.int64)

    def run(workers: int) -> Any:
        keys = []
        for a, b in ((labels[:, :-1], labels[:, 1:]), (labels[:-1], labels[1:])):
            apart = a != b
            keys.append((np.minimum(a[apart], b[apart]) << 32) | np.maximum(a[apart], b[apart]))
        return np.unique(np.concatenate(keys), return_counts=True)

    return run


def sampler_case(scene: Scene) -> Case:
    """Sweeps of the Gibbs sampler over the leaves; per node its neighbours, data and height."""
    model = city_model(scene.size)
    return Case(
        "Gibbs sampler of the leaves",
        "M updates/s",
        len(model.count) * SWEEPS / 1e6,
        SWEEPS * sweep_traffic(model),
        [Contestant("tilepipe sample", lambda: _sample(scene), ours=True, note="draws of both variances included")],
        aim=30,
    )


def sweep_traffic(model: CarModel) -> int:
    """Bytes that a sweep must move: of a node its data and height, of each end of an edge its number and height."""
    return len(model.count) * 40 + len(model.edges) * 2 * 12


def city_model(size: int) -> CarModel:
    """The model of the leaves of a city of ``size`` pixels a side, their spread limited as in `objects`."""
    labels, leaves = city_leaves(size)
    edges = adjacency.contacts(labels, leaves.first.size).edges - 1
    count, total = leaves.count.astype(float), leaves.total / 1000
    spread = np.clip(leaves.squares / 1e6 - total**2 / count, 0, count * DEVIATION**2 / 1e6)
    return CarModel(edges, None, count, total / count, spread)


def _sample(scene: Scene) -> Call:
    model = city_model(scene.size)
    return lambda workers: sample(model, burn_in=SWEEPS - 2, draws=2, tolerance=0.5, workers=workers)


def polygons_case(scene: Scene, tolerance: float = 0.0) -> Case:
    """Leaves to shapely polygons that share their borders, simplified by a tolerance in pixels."""
    regions = city_leaves(scene.size)[1].first.size
    simplified = tolerance > 0
    return Case(
        "simplified polygons" if simplified else "polygons of the leaves",
        "Mpx/s",
        scene.megapixels,
        4 * scene.size**2,
        [
            Contestant(
                f"tilepipe arcs{', simplify_polylines' * simplified} and polygons",
                lambda: _polygons(scene, tolerance),
                ours=True,
                note=f"{regions:,} regions",
            ),
            Contestant(
                f"rasterio.features.shapes{', coverage_simplify' * simplified}",
                lambda: _shapes(scene, tolerance),
                serial=True,
                share=1 / 16,
                note="a 16th",
            ),
        ],
        aim=8.5,
    )


def _polygons(scene: Scene, tolerance: float) -> Call:
    labels = city_leaves(scene.size)[0]

    def part(band: Band) -> Any:
        core = (band.core.start, band.core.stop, 0, scene.size)
        return trace_arcs(labels[band.padded], core, origin=(band.low, 0))

    def run(workers: int) -> Any:
        exact = join_arcs(over_bands(part, scene.size, 1, workers))
        rings = assemble_polygons(exact)
        return region_polygons(rings, simplify_polylines(exact, tolerance, 1.0, 1.0) if tolerance > 0 else exact)

    return run


def _shapes(scene: Scene, tolerance: float) -> Call:
    import shapely
    from rasterio.features import shapes
    from shapely.geometry import shape

    side = scene.size // 4
    labels = city_leaves(scene.size)[0][:side, :side].copy()

    def run(workers: int) -> Any:
        polygons = [shape(found) for found, _ in shapes(labels, connectivity=4)]
        return shapely.coverage_simplify(polygons, tolerance) if tolerance > 0 else polygons

    return run
