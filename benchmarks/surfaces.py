"""The kernels of `objects` beside what a user would pick instead: quadtree, contacts, sampler, polygons."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Call, Case, Contestant
from benchmarks.scenes import Band, Scene, over_bands
from tilepipe.arc_network import join_arcs
from tilepipe.object_leaves import to_ticks
from tilepipe.polygons import assemble_polygons
from tilepipe.synthetic import City, render
from tilepipe_kernels import adjacency, quadtree
from tilepipe_kernels.arcs import trace_arcs
from tilepipe_kernels.car import CarModel, sample
from tilepipe_kernels.merging import neighbour_lists

DEVIATION = 350.0
"""σ0 in ticks of a millimetre."""
SMALLEST, LARGEST = 2, 64
SWEEPS = 20


@cache
def _ticks(size: int) -> NDArray[np.int32]:
    return to_ticks(render(City(rows=size, columns=size), "height").astype(np.float32), 1.0)[0]


@cache
def _leaves(size: int) -> tuple[NDArray[np.int32], quadtree.LeafTable]:
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
    labels, leaves = _leaves(scene.size)
    count = leaves.first.size

    def part(band: Band) -> Any:
        block = labels[band.start : band.stop]
        low = max(int(block.min()), 1)
        return adjacency.contacts(np.maximum(block - (low - 1), 0), min(count, int(block.max())) - low + 1)

    return lambda workers: over_bands(part, scene.size, 0, workers)


def _numpy_contacts(scene: Scene) -> Call:
    labels = _leaves(scene.size)[0].astype(np.int64)

    def run(workers: int) -> Any:
        keys = []
        for a, b in ((labels[:, :-1], labels[:, 1:]), (labels[:-1], labels[1:])):
            apart = a != b
            keys.append((np.minimum(a[apart], b[apart]) << 32) | np.maximum(a[apart], b[apart]))
        return np.unique(np.concatenate(keys), return_counts=True)

    return run


def sampler_case(scene: Scene) -> Case:
    """Sweeps of the Gibbs sampler over the leaves; per node its neighbours, data and height."""
    leaves = _leaves(scene.size)[1]
    edges = len(adjacency.contacts(*_labels_and_count(scene)).edges)
    nodes = leaves.first.size
    return Case(
        "Gibbs sampler of the leaves",
        "M updates/s",
        nodes * SWEEPS / 1e6,
        SWEEPS * (nodes * 40 + edges * 2 * 16),
        [Contestant("tilepipe sample", lambda: _sample(scene), ours=True, note="draws of both variances included")],
        aim=30,
    )


def _labels_and_count(scene: Scene) -> tuple[NDArray[np.int32], int]:
    labels, leaves = _leaves(scene.size)
    return labels, leaves.first.size


def _sample(scene: Scene) -> Call:
    leaves = _leaves(scene.size)[1]
    edges = adjacency.contacts(*_labels_and_count(scene)).edges - 1
    offsets, neighbours, _ = neighbour_lists(np.ascontiguousarray(edges), leaves.first.size)
    count, total = leaves.count.astype(float), leaves.total / 1000
    spread = np.maximum(leaves.squares / 1e6 - total**2 / count, 0)
    model = CarModel(offsets, neighbours, np.ones(neighbours.size, np.float32), count, total / count, spread)
    return lambda workers: sample(model, burn_in=SWEEPS - 2, draws=2, tolerance=0.5, workers=workers)


def polygons_case(scene: Scene) -> Case:
    """Leaves to shapely polygons that share their borders."""
    return Case(
        "polygons of the leaves",
        "Mpx/s",
        scene.megapixels,
        4 * scene.size**2,
        [
            Contestant("tilepipe arcs and polygons", lambda: _polygons(scene), ours=True),
            Contestant("rasterio.features.shapes", lambda: _shapes(scene), serial=True, share=1 / 16, note="a 16th"),
        ],
        aim=8.5,
    )


def _polygons(scene: Scene) -> Call:
    labels = _leaves(scene.size)[0]

    def part(band: Band) -> Any:
        core = (band.core.start, band.core.stop, 0, scene.size)
        return trace_arcs(labels[band.padded], core, origin=(band.low, 0))

    def run(workers: int) -> Any:
        arcs = join_arcs(over_bands(part, scene.size, 1, workers))
        return assemble_polygons(arcs).geometries(arcs)

    return run


def _shapes(scene: Scene) -> Call:
    from rasterio.features import shapes
    from shapely.geometry import shape

    side = scene.size // 4
    labels = _leaves(scene.size)[0][:side, :side].copy()
    return lambda workers: [shape(found) for found, _ in shapes(labels, connectivity=4)]
