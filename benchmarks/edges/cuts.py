"""The peers of the optimisers of `edges`: minimum cuts by PyMaxflow and α-expansion by gco."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.edges.instances import Field, Instance
from benchmarks.measure.contest import Call, Unsuitable

LARGEST_COST = 5e6
"""Whole numbers that stand for the largest cost of gco, whose energies are integers below 10⁷."""


def minimum_cut(instance: Instance) -> Call:
    """The exact minimum for a convex potential, by a cut of layers (Ishikawa 2003); two labels make one layer.

    Node i of a pixel, for i from 0 to K - 2, says whether its label exceeds i.  For labels a > b an edge of weight
    w(k) from every node i of the one to node i - k of the other is cut max(0, a - b - k) times, so that the second
    differences of a potential of the difference are its weights.

    Raises
    ------
    ImportError
        Without PyMaxflow.
    Unsuitable
        For any other potential, and for weights of pairs.
    """
    import maxflow

    weights = _layer_weights(instance)
    unary = instance.unary.astype(np.float64)
    exceeding, not_exceeding = (np.ascontiguousarray(unary[..., part]) for part in (slice(1, None), slice(None, -1)))
    forbidden = float(np.abs(unary).sum() + unary.size * 4 * weights.sum())

    def run(workers: int) -> Field:
        graph = maxflow.GraphFloat()
        nodes = graph.add_grid_nodes(exceeding.shape)
        graph.add_grid_tedges(nodes, exceeding, not_exceeding)
        # a label that exceeds i + 1 exceeds i
        _join(graph, nodes[..., :-1], nodes[..., 1:], forbidden, 0.0)
        for one, other in ((nodes[:-1], nodes[1:]), (nodes[:, :-1], nodes[:, 1:])):
            _join(graph, one, other, weights[0], weights[0])
            for k in range(1, len(weights)):
                _join(graph, other[..., :-k], one[..., k:], weights[k], 0.0)
                _join(graph, one[..., :-k], other[..., k:], weights[k], 0.0)
        graph.maxflow()
        return np.asarray(graph.get_grid_segments(nodes).sum(axis=2), np.uint8)

    return run


def _layer_weights(instance: Instance) -> NDArray[np.float64]:
    """Second differences of the potential, (K - 1,)."""
    potential = instance.table[0]
    steps = np.abs(np.subtract.outer(*2 * [np.arange(instance.labels)]))
    if instance.down is not None or instance.right is not None or not np.allclose(instance.table, potential[steps]):
        raise Unsuitable("cuts layers for one potential of the difference of labels")
    weights = np.diff(np.diff(potential), prepend=0.0)
    if weights.min() < 0:
        raise Unsuitable("the potential is not convex, which an exact cut needs; α-expansion is not in it")
    return weights


def _join(graph: object, one: NDArray[np.int_], other: NDArray[np.int_], weight: float, back: float) -> None:
    if one.size and (weight or back):
        count = one.size
        graph.add_edges(one.ravel(), other.ravel(), np.full(count, weight), np.full(count, back))  # type: ignore[attr-defined]


def expansion(instance: Instance, cycles: int) -> Call:
    """α-expansion (Boykov et al. 2001) for so many cycles; -1 = until nothing changes.

    Raises
    ------
    ImportError
        Without gco.
    Unsuitable
        For a potential that is no metric.
    """
    import gco

    # a potential is a metric up to its value for equal labels, which costs all labellings the same
    table = instance.table - instance.table.diagonal().max()
    rows, columns, _ = instance.unary.shape
    weights = [np.ones((rows - 1, columns)), np.ones((rows, columns - 1))]
    unit = 1.0
    if instance.down is not None and instance.right is not None:
        weights = [instance.down, instance.right]
        unit = LARGEST_COST / max(float(instance.unary.max()), *(float(weight.max()) for weight in weights))
        scale = unit
    else:
        scale = LARGEST_COST / max(float(instance.unary.max()), float(table.max()))
        table = table * scale
    # rounded up a metric stays one
    whole = np.ceil(np.round(table, 6)).astype(np.int32)
    if not _is_metric(whole):
        raise Unsuitable("the potential is no metric, which α-expansion needs")
    unary = np.rint(instance.unary * scale).astype(np.int32)
    costs = [np.rint(weight * unit).astype(np.int32) for weight in weights]

    def run(workers: int) -> Field:
        found = gco.cut_grid_graph(unary, whole, *costs, n_iter=cycles, algorithm="expansion")
        return found.reshape(rows, columns).astype(np.uint8)

    return run


def _is_metric(table: NDArray[np.int32]) -> bool:
    """Whether V(a, a) = 0 <= V(a, c) <= V(a, b) + V(b, c) for all labels."""
    triangles = table[:, None, :] <= table[:, :, None] + table[None]
    return not table.diagonal().any() and bool((table >= 0).all() and triangles.all())
