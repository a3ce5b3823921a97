"""Loops of the CAR sampler: one sweep over colour classes, and the probability that two heights are the same."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from .car_model import Float32, Float64, Graph, Int32, Int64
from .compiled import loop
from .random import fill_normals, inlined_rule

BLOCK = 2048
"""Nodes of one partial sum: small enough for the caches, large enough to be handed to a thread."""

NODE_STREAM = np.uint64(0)
_FRACTION_BITS = np.uint64(52)
_LN2 = math.log(2)
_PER_LN2 = 1 / _LN2
_DENSITY_AT_0 = 1 / math.sqrt(2 * math.pi)


@loop
def update_blocks(
    graph: Graph, order: Int32, colours: NDArray[np.uint8], sites: Int64, bounds: Int64, first: int, last: int,
    smooth: float, fit: float, seed: np.uint64, sweep: np.uint64, x: Float64, sums: Float64,
) -> None:  # fmt: skip
    """Draw the sites of blocks `first` to `last`; block b is ``order[bounds[b]:bounds[b + 1]]``, of one colour.

    smooth = 1/v, fit = 1/s2.  An edge's difference is final when the later colour of its ends is drawn, and is
    summed then.  All differences are taken to the site's old value: nothing is lost with heights far from zero.
    """
    offsets, neighbours, weights = graph.offsets, graph.neighbours, graph.weights
    ids = np.empty(BLOCK, np.int64)
    noise = np.empty(BLOCK)
    for block in range(first, last):
        low, high = bounds[block], bounds[block + 1]
        for k in range(low, high):
            ids[k - low] = sites[order[k]] if sites.size else order[k]
        fill_normals(ids[: high - low], seed, sweep, NODE_STREAM, noise)
        roughness = misfit = 0.0
        for k in range(low, high):
            i = order[k]
            old, colour = x[i], colours[i]
            total = pull = earlier = earlier_pull = earlier_square = 0.0
            for e in range(offsets[i], offsets[i + 1]):
                j = neighbours[e]
                w = np.float64(weights[e])
                d = x[j] - old
                total += w
                pull += w * d
                final = colours[j] < colour
                earlier += w if final else 0.0
                earlier_pull += w * d if final else 0.0
                earlier_square += w * d * d if final else 0.0
            data, gap = graph.pixels[i] * fit, graph.mean[i] - old
            precision = data + total * smooth
            step = (data * gap + pull * smooth) / precision + noise[k - low] / math.sqrt(precision)
            x[i] = old + step
            # Sum w (d - step)² over the edges to earlier colours, without a second walk.
            roughness += earlier_square + step * (earlier * step - 2.0 * earlier_pull)
            d = gap - step
            misfit += graph.pixels[i] * d * d
        sums[block, 0] = roughness
        sums[block, 1] = misfit


@loop
def prepare_nodes(
    graph: Graph, smooth: float, fit: float, x: Float64, first: int, last: int,
    precision: Float64, pull: Float64, shift: Float64, square: Float64,
) -> None:  # fmt: skip
    """Add x to the running sums, and find each node's conditional precision q_i, and q_i times its mean."""
    for i in range(first * BLOCK, min(last * BLOCK, x.size)):
        d = x[i] - graph.mean[i]
        shift[i] += d
        square[i] += d * d
        total = sum_of_neighbours = 0.0
        for e in range(graph.offsets[i], graph.offsets[i + 1]):
            total += graph.weights[e]
            sum_of_neighbours += graph.weights[e] * x[graph.neighbours[e]]
        data = graph.pixels[i] * fit
        precision[i] = data + total * smooth
        pull[i] = data * graph.mean[i] + sum_of_neighbours * smooth


@inlined_rule
def normal_tail(x: float) -> float:
    """P(z > x) of a standard normal, x >= 0; error below 8e-8 (Abramowitz & Stegun 1964, 26.2.17).

    Arithmetic only, so that loops vectorise; e^(-y) is 2^(-k) times the Taylor series of the rest.
    """
    x = min(x, 30.0)
    y = 0.5 * x * x
    k = np.int32(y * _PER_LN2 + 0.5)
    r = k * _LN2 - y
    series = 1.0 + r / 5 * (1.0 + r / 6 * (1.0 + r / 7 * (1.0 + r / 8)))
    series = 1.0 + r * (1.0 + r / 2 * (1.0 + r / 3 * (1.0 + r / 4 * series)))
    power = np.uint64(np.uint64(np.int64(1023) - np.int64(k)) << _FRACTION_BITS).view(np.float64)
    t = 1.0 / (1.0 + 0.2316419 * x)
    polynomial = 1.781477937 + t * (-1.821255978 + t * 1.330274429)
    return series * power * _DENSITY_AT_0 * t * (0.319381530 + t * (-0.356563782 + t * polynomial))


@inlined_rule
def probability_within(centre: float, precision: float, tolerance: float) -> float:
    """P(|d| <= tolerance) of a normal d."""
    scale = math.sqrt(precision)
    near, far = (tolerance - abs(centre)) * scale, (tolerance + abs(centre)) * scale
    tail = normal_tail(abs(near))
    return max((1.0 - tail if near > 0.0 else tail) - normal_tail(far), 0.0)


@inlined_rule
def probability_of_same(b: float, r_i: float, h_i: float, r_j: float, h_j: float, tolerance: float) -> float:
    """P(|x_i - x_j| <= tolerance) given all other sites and the variances; b = w_ij/v.

    Without the edge, x_i and x_j would be independent with the precisions r and the means h/r.  Their difference
    would have the precision r_i r_j/(r_i + r_j), to which the edge adds b.
    """
    precision = b + r_i * r_j / (r_i + r_j)
    centre = (r_j * h_i - r_i * h_j) / ((r_i + r_j) * precision)
    return probability_within(centre, precision, tolerance)


@loop
def add_probabilities(
    graph: Graph, smooth: float, tolerance: float, x: Float64, precision: Float64, pull: Float64,
    edge_starts: Int64, first: int, last: int, same: Float32,
) -> None:  # fmt: skip
    """Add to `same` each edge's probability given the other sites: values are gathered first, then all computed."""
    for block in range(first, last):
        sums = same[edge_starts[block] : edge_starts[block + 1]]
        values = np.empty((5, sums.size))
        b, r_i, h_i, r_j, h_j = values[0], values[1], values[2], values[3], values[4]
        edge = 0
        for i in range(block * BLOCK, min(block * BLOCK + BLOCK, x.size)):
            for e in range(graph.offsets[i], graph.offsets[i + 1]):
                j = graph.neighbours[e]
                if j > i:
                    own = graph.weights[e] * smooth
                    b[edge] = own
                    r_i[edge], h_i[edge] = max(precision[i] - own, 0.0), pull[i] - own * x[j]
                    r_j[edge], h_j[edge] = max(precision[j] - own, 0.0), pull[j] - own * x[i]
                    edge += 1
        for k in range(sums.size):
            sums[k] += probability_of_same(b[k], r_i[k], h_i[k], r_j[k], h_j[k], tolerance)


@loop
def add_counts(
    graph: Graph, tolerance: float, x: Float64, edge_starts: Int64, first: int, last: int, same: Float32
) -> None:
    """Add to `same` whether each edge's heights are the same now."""
    for block in range(first, last):
        edge = edge_starts[block]
        for i in range(block * BLOCK, min(block * BLOCK + BLOCK, x.size)):
            for e in range(graph.offsets[i], graph.offsets[i + 1]):
                if graph.neighbours[e] > i:
                    same[edge] += abs(x[i] - x[graph.neighbours[e]]) <= tolerance
                    edge += 1


@loop
def find_edge_starts(offsets: Int64, neighbours: Int32, starts: Int64) -> None:
    """Index of the first edge (i, j), i < j, of each block of nodes, and the number of edges."""
    edges = 0
    for i in range(offsets.size - 1):
        if i % BLOCK == 0:
            starts[i // BLOCK] = edges
        for e in range(offsets[i], offsets[i + 1]):
            edges += neighbours[e] > i
    starts[-1] = edges
