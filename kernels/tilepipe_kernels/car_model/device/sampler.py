"""The sampler of `car_model` on the device: a thread for every lane of a block of rows, every node or edge."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np

from tilepipe_kernels.car_model.chain import Variances
from tilepipe_kernels.car_model.model import CarModel
from tilepipe_kernels.car_model.sweeps import (
    NODE_STREAM,
    add_neighbour,
    are_same,
    draw_site,
    probability_of_same,
    pull_of_data,
    pull_of_neighbour,
    without_edge,
)
from tilepipe_kernels.core.arrays import namespace, to_device, to_host
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.core.device.sums import sum_lanes
from tilepipe_kernels.core.random import normal
from tilepipe_kernels.core.sums import BLOCK, LANES
from tilepipe_kernels.regions.colouring import colour_graph, order_by_colour, rows_in_order
from tilepipe_kernels.regions.device.incidence import incidence

_PASSES = 4
"""Passes of `Edges.settle` between two looks at whether anything still moves."""


# ------------------------------------------------------------------------------------------------- sweeps


@grid
def _update(
    count: int, first: int, bounds: Any, offsets: Any, neighbours: Any, weights: Any, weighted: bool, pixels: Any,
    mean: Any, sites: Any, smooth: float, fit: float, seed: np.uint64, sweep: np.uint64, x: Any, lanes: Any,
) -> None:  # fmt: skip
    """Draw the rows of blocks from `first` on: a lane of a block draws every LANES-th row, as neighbours in memory."""
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        block, lane = first + p // LANES, p % LANES
        rough = 0.0
        misfits = 0.0
        for row in range(bounds[block] + lane, bounds[block + 1], LANES):
            old, around = x[row], (0.0, 0.0, 0.0, 0.0, 0.0)
            for e in range(offsets[row], offsets[row + 1]):
                j = neighbours[e]
                weight = np.float64(weights[e]) if weighted else 1.0
                around = add_neighbour(weight, x[j] - old, j < row, around)
            noise = normal(seed, np.uint64(sites[row]), sweep, NODE_STREAM)
            x[row], roughness, misfit = draw_site(old, pixels[row], mean[row], around, smooth, fit, noise)
            rough += roughness
            misfits += misfit
        lanes[block * LANES + lane, 0] = rough
        lanes[block * LANES + lane, 1] = misfits


class Gibbs:
    """State of one chain on the device, as `car_model.states` has it on the host; arrays in the order of the rows."""

    def __init__(self, model: CarModel, start: Any, sites: Any, seed: np.uint64) -> None:
        graph, self.seed = model.graph, seed
        xp = namespace(graph.edges)
        order, classes = order_by_colour(colour_graph(graph.edges, len(graph.mean)))
        self.rows = rows_in_order(graph.edges, graph.weights, order)
        starts = [np.arange(a, b, BLOCK) for a, b in itertools.pairwise(classes)]
        self.class_bounds = [0, *itertools.accumulate(map(len, starts))]
        self.bounds = to_device(np.append(np.concatenate(starts), classes[-1:]))
        self.pixels, self.mean, self.x = graph.pixels[order], graph.mean[order], start[order]
        self.sites = sites[order] if sites.size else order.astype(xp.int64)
        blocks = self.class_bounds[-1]
        self.lanes, self.sums = xp.empty((blocks * LANES, 2)), xp.empty((blocks, 2))

    def draw(self, variances: Variances, sweep: int) -> tuple[float, float]:
        """Update all sites, colour by colour; return roughness and misfit.

        The host adds the sums of blocks, 16 bytes for 2048 nodes, for it draws the variances.
        """
        smooth, fit, at = 1 / variances.smoothness, 1 / variances.noise, np.uint64(sweep)
        rows = self.rows
        for first, last in itertools.pairwise(self.class_bounds):
            _update(
                (last - first) * LANES, first, self.bounds, rows.offsets, rows.neighbours, rows.weights,
                rows.weights.size > 0, self.pixels, self.mean, self.sites, smooth, fit, self.seed, at, self.x,
                self.lanes,
            )  # fmt: skip
        sum_lanes(self.lanes, self.sums)
        roughness, misfit = to_host(self.sums).sum(axis=0)
        return float(roughness), float(misfit)

    def heights(self) -> Any:
        """Heights x in the order of the nodes."""
        heights = namespace(self.x).empty_like(self.x)
        heights[self.rows.order] = self.x
        return heights


# ------------------------------------------------------------------------------------------------- edges


@grid
def _condition(
    count: int, edges: Any, weights: Any, weighted: bool, offsets: Any, incident: Any, pixels: Any, mean: Any,
    smooth: float, fit: float, x: Any, precision: Any, pull: Any,
) -> None:  # fmt: skip
    for i in range(cuda.grid(1), count, cuda.gridsize(1)):
        q, h = pull_of_data(pixels[i], mean[i], fit)
        for at in range(offsets[i], offsets[i + 1]):
            e = incident[at]
            weight = np.float64(weights[e]) if weighted else 1.0
            b, of_other = pull_of_neighbour(weight, smooth, x[edges[e, 0] + edges[e, 1] - i])
            q += b
            h += of_other
        precision[i], pull[i] = q, h


@grid
def _add_probabilities(
    count: int, edges: Any, weights: Any, weighted: bool, smooth: float, tolerance: float, x: Any, precision: Any,
    pull: Any, same: Any,
) -> None:  # fmt: skip
    for e in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, j = edges[e, 0], edges[e, 1]
        b = (np.float64(weights[e]) if weighted else 1.0) * smooth
        r_i, h_i = without_edge(precision[i], pull[i], b, x[j])
        r_j, h_j = without_edge(precision[j], pull[j], b, x[i])
        same[e] = np.float32(np.float64(same[e]) + probability_of_same(b, r_i, h_i, r_j, h_j, tolerance))


@grid
def _add_counts(count: int, edges: Any, tolerance: float, x: Any, same: Any) -> None:
    for e in range(cuda.grid(1), count, cuda.gridsize(1)):
        if are_same(x[edges[e, 0]], x[edges[e, 1]], tolerance):
            same[e] += np.float32(1)


class Edges:
    """Probabilities that the two sides of each edge have the same height, as `car_model.states` finds them."""

    def __init__(self, model: CarModel, tolerance: float) -> None:
        self.graph, self.tolerance = model.graph, float(tolerance)
        xp = namespace(model.edges)
        self.at_nodes = incidence(model.edges, len(model.mean))
        self.precision, self.pull = xp.empty_like(model.mean), xp.empty_like(model.mean)
        self.same = xp.zeros(len(model.edges), xp.float32)

    def condition(self, smooth: float, fit: float, x: Any) -> None:
        """Find the conditionals of all heights given the others at x, and the precisions 1/v and 1/s2."""
        g = self.graph
        _condition(
            x.size, g.edges, g.weights, g.weights.size > 0, *self.at_nodes, g.pixels, g.mean, smooth, fit, x,
            self.precision, self.pull,
        )  # fmt: skip

    def settle(self, smooth: float, fit: float, x: Any, least: float, most: int) -> Any:
        """Move all heights to their conditional means until none is farther from it than `least`; return them.

        Heights that are settled stay where they are in further passes, so that the host looks only now and then.
        """
        xp = namespace(x)
        self.condition(smooth, fit, x)
        for done in range(1, most):
            wanted = self.pull / self.precision
            moves = xp.max(xp.abs(wanted - x)) > least
            x = xp.where(moves, wanted, x)
            self.condition(smooth, fit, x)
            if done % _PASSES == 0 and not bool(moves):
                break
        return x

    def add(self, smooth: float, x: Any) -> None:
        """Add the probabilities given the heights that the conditionals were found at."""
        g = self.graph
        _add_probabilities(
            len(self.same), g.edges, g.weights, g.weights.size > 0, smooth, self.tolerance, x, self.precision,
            self.pull, self.same,
        )  # fmt: skip

    def count(self, x: Any) -> None:
        """Add one where heights x are the same."""
        _add_counts(len(self.same), self.graph.edges, self.tolerance, x, self.same)
