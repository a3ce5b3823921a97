"""State of a chain of the CAR sampler, and of what it keeps of edges; `car_model.device.sampler` has the device's."""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Protocol

import numpy as np

from tilepipe_kernels.car_model.chain import Variances, level_of, spread_blocks
from tilepipe_kernels.car_model.exact import SOLVER_TOLERANCE, draw_exactly, measure
from tilepipe_kernels.car_model.model import CarModel, Float32, Float64, Int64
from tilepipe_kernels.car_model.sweeps import add_counts, add_probabilities, condition, settle, update_blocks
from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form
from tilepipe_kernels.core.sums import BLOCK
from tilepipe_kernels.regions.colouring import colour_graph, order_by_colour, rows_in_order


def start_of(model: CarModel) -> Float64:
    """Heights to start from: the means, and the mean of all where a node has no data."""
    if model.count.all():
        return model.mean
    start: Float64 = namespace(model.mean).where(model.count > 0, model.mean, level_of(model.count, model.mean))
    return start


class Chain(Protocol):
    """State of one chain, on the host or on a device."""

    def draw(self, variances: Variances, sweep: int) -> tuple[float, float]:
        """Update all sites; return roughness and misfit."""

    def heights(self) -> Float64:
        """Heights x in the order of the nodes."""


class Probabilities(Protocol):
    """Probabilities that the two sides of each edge have the same height, given all other heights and the variances."""

    same: Float32

    def condition(self, smooth: float, fit: float, x: Float64) -> None:
        """Find the conditionals of all heights given the others at x, and the precisions 1/v and 1/s2."""

    def settle(self, smooth: float, fit: float, x: Float64, least: float, most: int) -> Float64:
        """Pass over all conditionals until no height moves by more than `least`; return the heights."""

    def add(self, smooth: float, x: Float64) -> None:
        """Add the probabilities given the heights that the conditionals were found at."""

    def count(self, x: Float64) -> None:
        """Add one where heights x are the same."""


class Gibbs:
    """State of one chain that updates site by site: rows and heights stand in the order of their colours."""

    def __init__(
        self, model: CarModel, sites: Int64, seed: np.uint64, workers: int, pool: ThreadPoolExecutor | None
    ) -> None:
        self.graph, self.sites, self.seed = model.graph, sites, seed
        self.serial, self.spread_out = pool is None, partial(spread_blocks, pool, workers)
        order, classes = order_by_colour(colour_graph(model.edges, len(model.count)))
        self.rows = rows_in_order(self.graph.edges, self.graph.weights, order)
        starts = [np.arange(a, b, BLOCK) for a, b in itertools.pairwise(classes)]
        self.bounds = np.append(np.concatenate(starts), classes[-1:])
        self.class_bounds = [0, *itertools.accumulate(map(len, starts))]
        self.sums = np.empty((len(self.bounds) - 1, 2))
        self.x = start_of(model)[order]

    def draw(self, variances: Variances, sweep: int) -> tuple[float, float]:
        """Update all sites, colour by colour; return roughness and misfit."""
        smooth, fit, at = 1 / variances.smoothness, 1 / variances.noise, np.uint64(sweep)

        def work(first: int, last: int) -> None:
            update_blocks(
                self.rows, self.graph, self.sites, self.bounds, first, last, smooth, fit, self.seed, at, self.x,
                self.sums,
            )  # fmt: skip

        if self.serial:  # blocks stand in the order of their colours
            work(0, len(self.sums))
        else:
            for first, last in itertools.pairwise(self.class_bounds):
                self.spread_out(work, first, last)
        roughness, misfit = self.sums.sum(axis=0)
        return float(roughness), float(misfit)

    def heights(self) -> Float64:
        """Heights x in the order of the nodes."""
        heights = np.empty_like(self.x)
        heights[self.rows.order] = self.x
        return heights


class Exact:
    """State of one chain that draws all sites at once."""

    def __init__(self, model: CarModel, sites: Int64, seed: np.uint64) -> None:
        self.graph, self.sites, self.seed, self.x = model.graph, sites, seed, start_of(model).copy()
        self.scratch = np.empty_like(self.x), np.empty_like(self.x)

    def draw(self, variances: Variances, sweep: int) -> tuple[float, float]:
        """Draw all sites; return roughness and misfit."""
        draw_exactly(
            self.graph, self.sites, variances.smoothness, variances.noise, self.seed, sweep, self.x,
            SOLVER_TOLERANCE, self.scratch,
        )  # fmt: skip
        return measure(self.graph, self.x)

    def heights(self) -> Float64:
        """Heights x in the order of the nodes."""
        return self.x


class Edges:
    """Probabilities of the edges on the host."""

    def __init__(self, model: CarModel, tolerance: float, workers: int, pool: ThreadPoolExecutor | None) -> None:
        self.graph, self.tolerance, self.spread_out = model.graph, tolerance, partial(spread_blocks, pool, workers)
        self.precision, self.pull = np.empty_like(model.mean), np.empty_like(model.mean)
        self.same: Float32 = np.zeros(len(model.edges), np.float32)

    def condition(self, smooth: float, fit: float, x: Float64) -> None:
        """Find the conditionals of all heights given the others at x, and the precisions 1/v and 1/s2."""
        condition(self.graph, smooth, fit, x, self.precision, self.pull)

    def settle(self, smooth: float, fit: float, x: Float64, least: float, most: int) -> Float64:
        """Pass over all conditionals until no height moves by more than `least`; return the heights."""
        x = x.copy()
        self.condition(smooth, fit, x)
        passes = 1
        while passes < most and settle(self.precision, self.pull, x, least):
            self.condition(smooth, fit, x)
            passes += 1
        return x

    def add(self, smooth: float, x: Float64) -> None:
        """Add the probabilities given the heights that the conditionals were found at."""
        graph = self.graph

        def work(first: int, last: int) -> None:
            add_probabilities(
                graph, smooth, self.tolerance, x, self.precision, self.pull, first, last, self.same
            )  # fmt: skip

        self.spread_out(work, 0, len(self.same))

    def count(self, x: Float64) -> None:
        """Add one where heights x are the same."""
        add_counts(self.graph, self.tolerance, x, 0, len(self.same), self.same)


def gibbs_chain(model: CarModel, sites: Int64, seed: np.uint64, workers: int, pool: ThreadPoolExecutor | None) -> Chain:
    """A chain of single-site updates where the model lies."""
    if on_device(model.mean):
        device = device_form(f"{__package__}.sampler")
        return device.Gibbs(model, start_of(model), sites, seed)
    return Gibbs(model, sites, seed, workers, pool)


def edge_probabilities(
    model: CarModel, tolerance: float, workers: int, pool: ThreadPoolExecutor | None
) -> Probabilities:  # fmt: skip
    """Probabilities of the edges where the model lies."""
    if on_device(model.mean):
        device = device_form(f"{__package__}.sampler")
        return device.Edges(model, tolerance)
    return Edges(model, tolerance, workers, pool)
