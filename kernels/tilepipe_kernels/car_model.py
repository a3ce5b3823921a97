"""Gibbs sampler of the conditional autoregressive (CAR) model of region heights (`objects`, step 4).

Pixel heights ``y_ip ~ N(x_i, s2)`` of region i enter by their count n_i, mean m_i and spread S_i = Σ (y - m_i)².
Region heights are ``x_i = μ_c + ε_i`` with a flat prior on the level μ_c of each connected component c, and the
intrinsic CAR prior of Besag, York & Mollié (1991) on ε,

    p(ε | v) ∝ v^(-(N - C)/2) exp(-1/(2 v) Σ_edges w_ij (ε_i - ε_j)²),    Σ_{i in c} ε_i = 0.

(μ, ε) ↦ x is linear and one to one, so its Jacobian is constant; the prior depends on differences only, in which μ
cancels.  So x itself has the density above, without constraint, and is sampled directly; μ_c is the mean of x over
its component.  The full conditionals are

    x_i | rest ~ N((n_i m_i/s2 + Σ_j w_ij x_j/v)/q_i, 1/q_i),             q_i = n_i/s2 + Σ_j w_ij/v,
    1/v  | x ~ Gamma(a_v + (N - C)/2, b_v + Σ_edges w_ij (x_i - x_j)²/2),
    1/s2 | x ~ Gamma(a_s + Σ n_i/2, b_s + Σ (S_i + n_i (m_i - x_i)²)/2).

Sites of one colour are independent given the others and are updated together.  Numbers are drawn by site and
sweep (`random`), and sums are taken in blocks of fixed size: threads do not show in the result.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .colouring import count_components
from .compiled import loop

Float64 = NDArray[np.float64]
Float32 = NDArray[np.float32]
Int64 = NDArray[np.int64]
Int32 = NDArray[np.int32]


@dataclass(frozen=True)
class Priors:
    """Gamma priors of the precisions 1/v (smoothness) and 1/s2 (noise): shapes, and rates in m² (for w = 1)."""

    smoothness_shape: float = 0.5
    smoothness_rate: float = 0.0005
    noise_shape: float = 0.5
    noise_rate: float = 0.0005

    def __post_init__(self) -> None:
        if not min(self.smoothness_shape, self.smoothness_rate, self.noise_shape, self.noise_rate) > 0:
            raise ValueError(f"shapes and rates of the priors must be positive, not {self}")


class Graph(NamedTuple):
    """Symmetric weighted graph in compressed sparse rows, and the data of its nodes, for the loops."""

    offsets: Int64
    neighbours: Int32
    weights: Float32
    pixels: Float64
    mean: Float64


@loop
def _graph_fault(offsets: Int64, neighbours: Int32, weights: Float32) -> int:
    """0 if sound, 1 for wrong rows, 2 for wrong weights, 3 for edges that are not the same from both ends."""
    n = offsets.size - 1
    if offsets[0] != 0 or offsets[n] != neighbours.size or weights.size != neighbours.size:
        return 1
    for i in range(n):
        if offsets[i + 1] < offsets[i] or offsets[i + 1] > neighbours.size:
            return 1
        for k in range(offsets[i], offsets[i + 1]):
            j = neighbours[k]
            if j < 0 or j >= n or j == i or (k > offsets[i] and j <= neighbours[k - 1]):
                return 1
            if not (weights[k] > 0 and weights[k] < np.inf):
                return 2
    # Rows ascend, so the lower neighbours of every node must turn up in their order while i goes up.
    cursor = offsets[:n].copy()
    for i in range(n):
        if cursor[i] < offsets[i + 1] and neighbours[cursor[i]] < i:
            return 3
        for k in range(cursor[i], offsets[i + 1]):
            j = neighbours[k]
            place = cursor[j]
            if place >= offsets[j + 1] or neighbours[place] != i or weights[place] != weights[k]:
                return 3
            cursor[j] = place + 1
    return 0


_FAULTS = {
    1: "offsets and neighbours must be compressed sparse rows, each ascending and without its own node",
    2: "weights must be positive and finite; leave out edges of weight 0",
    3: "the graph must be symmetric: every edge in both rows, with one weight",
}


@dataclass(frozen=True)
class CarModel:
    """Region graph and its data.

    Parameters
    ----------
    offsets, neighbours, weights
        Symmetric graph in compressed sparse rows: int64 (n + 1,), int32 (2 m,), float32 (2 m,) > 0; neighbours
        ascend within a row.  Nodes stand in the order of their global ids.
    count, mean, spread
        float64 (n,): pixels, mean height (m) and sum of squared deviations from it (m²).  A node may have
        count 0 (mean finite but unused), if its component has data elsewhere.
    priors
        Of the two variances.

    Raises
    ------
    ValueError
        For arrays that do not fit together, a graph that is not symmetric, data that are not finite, a
        component without data.
    """

    offsets: Int64
    neighbours: Int32
    weights: Float32
    count: Float64
    mean: Float64
    spread: Float64
    priors: Priors = Priors()
    components: int = field(init=False)

    def __post_init__(self) -> None:
        kinds = {"offsets": np.int64, "neighbours": np.int32, "weights": np.float32}
        for name in ("offsets", "neighbours", "weights", "count", "mean", "spread"):
            array = np.ascontiguousarray(getattr(self, name), dtype=kinds.get(name, np.float64))
            object.__setattr__(self, name, array)
        n = len(self.offsets) - 1
        if n < 1 or not len(self.count) == len(self.mean) == len(self.spread) == n:
            raise ValueError(f"count, mean and spread must have one value for each of the {n} nodes, at least one")
        if fault := _graph_fault(self.offsets, self.neighbours, self.weights):
            raise ValueError(_FAULTS[fault])
        if not (np.isfinite(self.mean).all() and self.count.min() >= 0 and self.spread.min() >= 0):
            raise ValueError("means must be finite, counts and spreads 0 or more")
        if not (np.isfinite(self.count.sum()) and np.isfinite(self.spread.sum())):
            raise ValueError("counts and spreads must be finite")
        components, without_data = count_components(self.offsets, self.neighbours, self.count > 0)
        if without_data:
            raise ValueError(f"{without_data} connected components have no data; leave them out of the graph")
        object.__setattr__(self, "components", components)

    @property
    def graph(self) -> Graph:
        """The arrays that loops walk."""
        return Graph(self.offsets, self.neighbours, self.weights, self.count, self.mean)

    def edges(self) -> Int32:
        """Edges (i, j), i < j, int32 (m, 2), in lexicographic order: that of ``Posterior.same``."""
        i = np.repeat(np.arange(len(self.count), dtype=np.int32), np.diff(self.offsets))
        upper = self.neighbours > i
        return np.stack([i[upper], self.neighbours[upper]], axis=1)


@dataclass(frozen=True)
class Posterior:
    """What the draws say.

    Attributes
    ----------
    smoothness, noise, log_density
        float64 (draws,): v and s2 (m²), and the logarithm of the joint density of data, x, 1/v and 1/s2 up to a
        constant, after each kept sweep.
    mean, sd
        float64, of each node (or pixel): posterior mean and standard deviation of x, m.
    same
        float32 (m,): of each edge the probability that its two heights differ by at most the tolerance; None on a
        grid.
    """

    smoothness: Float64
    noise: Float64
    log_density: Float64
    mean: Float64
    sd: Float64
    same: Float32 | None
