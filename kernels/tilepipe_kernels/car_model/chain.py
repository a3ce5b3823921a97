"""What every chain of the CAR model does, on a graph or a grid: draw the variances, keep traces, use threads."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from tilepipe_kernels.car_model.model import Float64, Priors
from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.random import gamma
from tilepipe_kernels.core.sums import ordered_sum

_SITE_OF_V = np.uint64(2**64 - 1)
_SITE_OF_NOISE = np.uint64(2**64 - 2)


def level_of(count: Float64, mean: Float64) -> float:
    """Mean height of all pixels."""
    return ordered_sum(count * mean) / ordered_sum(count)


@dataclass
class Variances:
    """Conditionals of v and s2: what they need of the data, and their last values."""

    priors: Priors
    rank: float  # N - C
    pixels: float
    spread: float
    fixed: bool
    seed: np.uint64
    smoothness: float
    noise: float

    @classmethod
    def start(
        cls, priors: Priors, rank: float, count: Float64, mean: Float64, spread: float, pixels: float,
        fixed: float | None, seed: np.uint64,
    ) -> Variances:  # fmt: skip
        """Begin at the variance of all heights, so that no chain starts stuck to its data."""
        if fixed is not None and not 0 < fixed < math.inf:
            raise ValueError(f"the fixed variance must be positive, not {fixed} m²")
        step = mean - level_of(count, mean)
        scale = (ordered_sum(count * (step * step)) + spread) / pixels or 1.0
        return cls(priors, rank, pixels, spread, fixed is not None, seed, scale, scale if fixed is None else fixed)

    def draw(self, roughness: float, misfit: float, sweep: int) -> None:
        """Draw both given x: `roughness` is Σ w (x_i - x_j)², `misfit` is Σ n (m - x)²."""
        p, at = self.priors, np.uint64(sweep)
        rate = p.smoothness_rate + roughness / 2
        self.smoothness = rate / gamma(p.smoothness_shape + self.rank / 2, self.seed, _SITE_OF_V, at)
        if not self.fixed:
            rate = p.noise_rate + (self.spread + misfit) / 2
            self.noise = rate / gamma(p.noise_shape + self.pixels / 2, self.seed, _SITE_OF_NOISE, at)

    def log_density(self, roughness: float, misfit: float) -> float:
        """Logarithm of the joint density of data, x and the precisions, up to a constant."""
        p, v, s2 = self.priors, self.smoothness, self.noise
        likelihood = -self.pixels / 2 * math.log(s2) - (self.spread + misfit) / (2 * s2)
        prior = -(p.smoothness_shape - 1 + self.rank / 2) * math.log(v) - (p.smoothness_rate + roughness / 2) / v
        if not self.fixed:
            prior -= (p.noise_shape - 1) * math.log(s2) + p.noise_rate / s2
        return likelihood + prior


def run_chain(
    draw: Callable[[Variances, int], tuple[float, float]], keep: Callable[[], None], variances: Variances,
    burn_in: int, draws: int, thinning: int,
) -> tuple[Float64, Float64, Float64]:  # fmt: skip
    """Alternate x and the variances; return the traces of v, s2 and the log density."""
    traces = np.empty((3, draws))
    for sweep in range(burn_in + draws * thinning):
        roughness, misfit = draw(variances, sweep)
        variances.draw(roughness, misfit, sweep)
        if sweep >= burn_in and (sweep - burn_in + 1) % thinning == 0:
            density = variances.log_density(roughness, misfit)
            traces[:, (sweep - burn_in) // thinning] = variances.smoothness, variances.noise, density
            keep()
    return traces[0], traces[1], traces[2]


def check_lengths(burn_in: int, draws: int, thinning: int, workers: int) -> None:
    """Refuse lengths of a chain or a number of threads out of their ranges."""
    if burn_in < 0 or draws < 2 or thinning < 1 or burn_in + draws * thinning >= 2**32:
        raise ValueError(f"need burn_in >= 0, draws >= 2, thinning >= 1, not {burn_in}, {draws}, {thinning}")
    if workers < 1:
        raise ValueError(f"workers must be 1 or more, not {workers}")


def check_tolerance(tolerance: float) -> None:
    """Refuse a tolerance out of its range."""
    if not tolerance >= 0:
        raise ValueError(f"tolerance must be 0 m or more, not {tolerance}")


def moments(reference: Float64, shift: Float64, square: Float64, draws: int) -> tuple[Float64, Float64]:
    """Mean and standard deviation from running sums of differences to a reference; overwrites the sums."""
    shift /= draws
    square -= draws * shift * shift
    xp = namespace(square)
    xp.maximum(square, 0, out=square)
    square /= draws - 1
    xp.sqrt(square, out=square)
    shift += reference
    return shift, square


def spread_blocks(
    pool: ThreadPoolExecutor | None, workers: int, work: Callable[[int, int], None], first: int, last: int
) -> None:
    """Call ``work(first, last)`` over ranges of blocks, in threads where there is more than one."""
    if pool is None or last - first < 2:
        work(first, last)
        return
    bounds = np.linspace(first, last, min(workers, last - first) + 1).astype(int)
    list(pool.map(work, bounds[:-1], bounds[1:]))
