"""The CAR model as its joint density says it, dense: a sampler that knows nothing else, and exact integrals."""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp, ndtr

from tilepipe_kernels.car_model.model import CarModel
from tilepipe_kernels.core.random import gamma, normal


@dataclass
class Scene:
    """Edges (m, 2), weights, and data of the nodes."""

    edges: np.ndarray
    weights: np.ndarray
    count: np.ndarray
    mean: np.ndarray
    spread: np.ndarray
    components: int = 1

    def model(self) -> CarModel:
        return CarModel(self.edges, self.weights, self.count, self.mean, self.spread)

    def log_joint(self, x, smooth, fit, a=0.5, b=0.0005):
        """Log density of data, x and the precisions 1/v = smooth and 1/s2 = fit."""
        i, j = self.edges.T
        rank = len(x) - self.components
        prior = rank / 2 * np.log(smooth) - smooth / 2 * (self.weights * (x[i] - x[j]) ** 2).sum()
        misfit = (self.spread + self.count * (self.mean - x) ** 2).sum()
        likelihood = self.count.sum() / 2 * np.log(fit) - fit / 2 * misfit
        return prior + likelihood + (a - 1) * np.log(smooth * fit) - b * (smooth + fit)

    def precision(self, smooth, fit):
        i, j = self.edges.T
        matrix = np.diag(self.count * fit)
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            np.add.at(matrix, (a, b), sign * smooth * self.weights)
        return matrix


def random_scene(seed: int, nodes: int = 6, extra: int = 4, components: int = 1) -> Scene:
    rng = np.random.default_rng(seed)
    part = np.arange(nodes) % components
    tree = [(rng.choice(np.flatnonzero(part[:i] == part[i])), i) for i in range(components, nodes)]
    pairs = [(i, j) for i in range(nodes) for j in range(i + 1, nodes) if part[i] == part[j]]
    more = [pairs[k] for k in rng.choice(len(pairs), min(extra, len(pairs)), replace=False)]
    edges = np.array(sorted({(int(a), int(b)) for a, b in tree + more}))
    count = rng.integers(1, 9, nodes).astype(float)
    weights = rng.uniform(0.5, 2, len(edges)).astype(np.float32).astype(float)
    spread = 0.3 * rng.chisquare(np.maximum(count - 1, 0.1)) * (count > 1)
    return Scene(edges, weights, count, rng.normal(20, 1.5, nodes), spread, components)


def greedy_classes(scene: Scene) -> list[list[int]]:
    colours: list[int] = []
    for i in range(len(scene.count)):
        taken = {colours[a + b - i] for a, b in scene.edges.tolist() if i in (a, b) and a + b - i < i}
        colours.append(min(set(range(len(taken) + 1)) - taken))
    return [[i for i, c in enumerate(colours) if c == colour] for colour in range(max(colours) + 1)]


def _gamma_of(log_density, at: float) -> tuple[float, float]:
    """Shape and rate of the gamma density of which three values of the logarithm are given by a function."""
    t = at * np.array([0.5, 1.0, 2.0])
    values = np.array([log_density(value) for value in t])
    matrix = np.stack([np.log(t), -t, np.ones(3)], axis=1)
    shape, rate, _ = np.linalg.solve(matrix, values)
    return shape + 1, rate


def naive_sample(scene: Scene, sweeps: int, seed: int, ids: np.ndarray):
    """Draw every conditional from differences of the joint density; return v, s2 and x after each sweep."""
    level = (scene.count * scene.mean).sum() / scene.count.sum()
    scale = ((scene.count * (scene.mean - level) ** 2).sum() + scene.spread.sum()) / scene.count.sum()
    smooth = fit = 1 / scale
    x = np.where(scene.count > 0, scene.mean, level)
    traces = []
    for sweep in range(sweeps):
        for members in greedy_classes(scene):
            for i in members:
                step = np.eye(len(x))[i]
                low, here, high = (scene.log_joint(x + d * step, smooth, fit) for d in (-1, 0, 1))
                q = 2 * here - low - high
                z = normal(*map(np.uint64, (seed, ids[i], sweep, 0)))
                x[i] += (high - low) / 2 / q + z / np.sqrt(q)
        shape, rate = _gamma_of(lambda t, fit=fit: scene.log_joint(x, t, fit), smooth)
        smooth = gamma(shape, *map(np.uint64, (seed, 2**64 - 1, sweep))) / rate
        shape, rate = _gamma_of(lambda t, smooth=smooth: scene.log_joint(x, smooth, t), fit)
        fit = gamma(shape, *map(np.uint64, (seed, 2**64 - 2, sweep))) / rate
        traces.append((1 / smooth, 1 / fit, x.copy()))
    return tuple(map(np.array, zip(*traces, strict=True)))


def integrate(scene: Scene, tolerance: float, size: int = 70):
    """Posterior by integrating x out exactly and both precisions on a grid of their logarithms.

    Returns mean and sd of x, mean of log v and log s2, and P(|x_i - x_j| <= tolerance) of the edges.
    """
    axis_v, axis_s = np.linspace(-8, 9, size), np.linspace(-6, 7, size)
    logs, means, variances, same = [], [], [], []
    i, j = scene.edges.T
    for log_smooth in axis_v:
        for log_fit in axis_s:
            smooth, fit = np.exp(log_smooth), np.exp(log_fit)
            covariance = np.linalg.inv(scene.precision(smooth, fit))
            centre = covariance @ (fit * scene.count * scene.mean)
            _, determinant = np.linalg.slogdet(covariance)
            # The logarithms' Jacobian is smooth * fit.
            logs.append(scene.log_joint(centre, smooth, fit) + determinant / 2 + log_smooth + log_fit)
            means.append(centre)
            variances.append(np.diag(covariance))
            sd = np.sqrt(covariance[i, i] + covariance[j, j] - 2 * covariance[i, j])
            d = centre[i] - centre[j]
            same.append(ndtr((tolerance - d) / sd) - ndtr((-tolerance - d) / sd))
    weights = np.exp(np.array(logs) - logsumexp(logs))
    means, variances = np.array(means), np.array(variances)
    mean = weights @ means
    sd = np.sqrt(weights @ (variances + (means - mean) ** 2))
    log_v = -(weights.reshape(size, size).sum(axis=1) @ axis_v)
    log_s2 = -(weights.reshape(size, size).sum(axis=0) @ axis_s)
    edge_weight = max(weights.reshape(size, size)[[0, -1]].sum(), weights.reshape(size, size)[:, [0, -1]].sum())
    assert edge_weight < 1e-4, "the grid of the integral is too narrow"
    return mean, sd, log_v, log_s2, weights @ np.array(same)
