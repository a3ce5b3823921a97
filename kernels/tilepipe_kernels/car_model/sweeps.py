"""Rules and loops of the CAR sampler: a sweep over colour classes, the probability that two heights are the same."""

from __future__ import annotations

import math

import numpy as np

from tilepipe_kernels.car_model.model import Float32, Float64, Graph, Int64, weight_of
from tilepipe_kernels.core.compiled import inlined_rule, loop
from tilepipe_kernels.core.random import fill_normals
from tilepipe_kernels.core.sums import BLOCK, LANES, sum_of_lanes
from tilepipe_kernels.regions.colouring import Rows

_STRETCH = 1024
"""Edges whose values are gathered at once."""

NODE_STREAM = np.uint64(0)
_FRACTION_BITS = np.uint64(52)
_LN2 = math.log(2)
_PER_LN2 = 1 / _LN2
_DENSITY_AT_0 = 1 / math.sqrt(2 * math.pi)


Neighbours = tuple[float, float, float, float, float]
"""Of a site: sums of w and of w d over its neighbours, and of w, w d and w d² over those of earlier colours."""


@inlined_rule
def add_neighbour(w: float, d: float, earlier: bool, sums: Neighbours) -> Neighbours:
    """Take a neighbour into the sums of a site; d is its height less the site's old one."""
    total, pull, final, final_pull, final_square = sums
    own = w if earlier else 0.0
    return total + w, pull + w * d, final + own, final_pull + own * d, final_square + own * d * d


@inlined_rule
def draw_site(
    old: float, pixels: float, mean: float, sums: Neighbours, smooth: float, fit: float, noise: float
) -> tuple[float, float, float]:
    """Draw a height; return it with what it adds to the roughness Σ w d² and the misfit Σ n (m - x)².

    smooth = 1/v, fit = 1/s2.  An edge's difference is final when the later colour of its ends is drawn, and is summed
    then.  All differences are taken to the site's old value: nothing is lost with heights far from zero.
    """
    total, pull, final, final_pull, final_square = sums
    data, gap = pixels * fit, mean - old
    precision = data + total * smooth
    step = (data * gap + pull * smooth) / precision + noise / math.sqrt(precision)
    # Sum w (d - step)² over the edges to earlier colours, without a second walk.
    roughness = final_square + step * (final * step - 2.0 * final_pull)
    d = gap - step
    return old + step, roughness, pixels * d * d


@loop
def update_blocks(
    rows: Rows, graph: Graph, sites: Int64, bounds: Int64, first: int, last: int,
    smooth: float, fit: float, seed: np.uint64, sweep: np.uint64, x: Float64, sums: Float64,
) -> None:  # fmt: skip
    """Draw the sites of blocks `first` to `last`; block b is rows ``bounds[b]`` to ``bounds[b + 1]``, of one colour.

    x stands in the order of the rows; roughness and misfit of each block go into `sums`.
    """
    offsets, neighbours, order = rows.offsets, rows.neighbours, rows.order
    ids = np.empty(BLOCK, np.int64)
    noise = np.empty(BLOCK)
    rough, misfits = np.zeros(LANES), np.zeros(LANES)
    for block in range(first, last):
        low, high = bounds[block], bounds[block + 1]
        for k in range(low, high):
            ids[k - low] = sites[order[k]] if sites.size else order[k]
        fill_normals(ids[: high - low], seed, sweep, NODE_STREAM, noise)
        for k in range(high - low):
            row = low + k
            i = np.uint32(order[row])
            old, around = x[row], (0.0, 0.0, 0.0, 0.0, 0.0)
            for e in range(offsets[row], offsets[row + 1]):
                j = np.uint32(neighbours[e])
                around = add_neighbour(weight_of(rows.weights, e), x[j] - old, j < row, around)
            x[row], roughness, misfit = draw_site(old, graph.pixels[i], graph.mean[i], around, smooth, fit, noise[k])
            lane = np.uint32(k % LANES)
            rough[lane] += roughness
            misfits[lane] += misfit
        sums[block, 0], sums[block, 1] = sum_of_lanes(rough, misfits, high - low)


@inlined_rule
def pull_of_data(pixels: float, mean: float, fit: float) -> tuple[float, float]:
    """Precision of a site by its data, and that times the height that they pull to."""
    return pixels * fit, pixels * fit * mean


@inlined_rule
def pull_of_neighbour(w: float, smooth: float, x: float) -> tuple[float, float]:
    """Precision that a neighbour at x adds to a site, and that times x."""
    return w * smooth, w * smooth * x


@loop
def condition(graph: Graph, smooth: float, fit: float, x: Float64, precision: Float64, pull: Float64) -> None:
    """Find each node's conditional precision q_i given its neighbours' x, and q_i times its conditional mean."""
    for i in range(x.size):
        precision[i], pull[i] = pull_of_data(graph.pixels[i], graph.mean[i], fit)
    for e in range(graph.edges.shape[0]):
        i, j = graph.edges[e, 0], graph.edges[e, 1]
        b, of_j = pull_of_neighbour(weight_of(graph.weights, e), smooth, x[j])
        _, of_i = pull_of_neighbour(weight_of(graph.weights, e), smooth, x[i])
        precision[i] += b
        precision[j] += b
        pull[i] += of_j
        pull[j] += of_i


@loop
def settle(precision: Float64, pull: Float64, x: Float64, least: float) -> bool:
    """Set every x to its conditional mean if any is farther from it than `least`; return whether."""
    largest = 0.0
    for i in range(x.size):
        largest = max(largest, abs(pull[i] / precision[i] - x[i]))
    if not largest > least:
        return False
    for i in range(x.size):
        x[i] = pull[i] / precision[i]
    return True


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


@inlined_rule
def without_edge(precision: float, pull: float, b: float, other: float) -> tuple[float, float]:
    """Precision r of a site without the edge of coupling b to a site at `other`, and h, r times the mean."""
    return max(precision - b, 0.0), pull - b * other


@inlined_rule
def are_same(a: float, b: float, tolerance: float) -> bool:
    """Whether two heights count as the same."""
    return abs(a - b) <= tolerance


@loop
def add_probabilities(
    graph: Graph, smooth: float, tolerance: float, x: Float64, precision: Float64, pull: Float64,
    first: int, last: int, same: Float32,
) -> None:  # fmt: skip
    """Add to `same` the probabilities of edges `first` to `last` given the other sites.

    Values are gathered first, then all computed, in stretches that the caches hold.
    """
    values = np.empty((5, _STRETCH))
    b, r_i, h_i, r_j, h_j = values[0], values[1], values[2], values[3], values[4]
    for low in range(first, last, _STRETCH):
        sums, edges = same[low : min(low + _STRETCH, last)], graph.edges[low : min(low + _STRETCH, last)]
        for k in range(sums.size):
            i, j = edges[k, 0], edges[k, 1]
            own = weight_of(graph.weights, low + k) * smooth
            b[k] = own
            r_i[k], h_i[k] = without_edge(precision[i], pull[i], own, x[j])
            r_j[k], h_j[k] = without_edge(precision[j], pull[j], own, x[i])
        for k in range(sums.size):
            sums[k] += probability_of_same(b[k], r_i[k], h_i[k], r_j[k], h_j[k], tolerance)


@loop
def add_counts(graph: Graph, tolerance: float, x: Float64, first: int, last: int, same: Float32) -> None:
    """Add to `same` whether the heights of edges `first` to `last` are the same now."""
    for e in range(first, last):
        same[e] += are_same(x[graph.edges[e, 0]], x[graph.edges[e, 1]], tolerance)
