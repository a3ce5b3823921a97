"""Rivals of the sampler of `objects`: the plain loop that one would write with numba, and JAGS."""

# ruff: noqa: NPY002 - the functions of numpy.random are what numba compiles and what a plain loop calls
from __future__ import annotations

import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from benchmarks.measure.contest import Unsuitable
from tilepipe_kernels.car_model.model import CarModel

REFERENCE = Path(__file__).resolve().parents[2] / "scripts" / "reference_car"
"""Script that holds the model in JAGS's language."""
LARGEST_JAGS = 100_000
"""Nodes of the largest graph that JAGS is given: it keeps every node and edge as an object of its own."""
JAGS_PATIENCE = 75.0
"""Seconds after which JAGS is ended."""

Float64 = NDArray[np.float64]


@dataclass(frozen=True)
class Chains:
    """What two independent chains did, one after the other.

    Attributes
    ----------
    variances
        float64 (2, 2, draws): v and s2, by chain, after each sweep that counts.
    mean, sd
        float64 (2, nodes): moments of the heights, by chain.
    same
        float (2, edges): probability that two heights are alike, by chain; None where it is not asked for.
    seconds
        Of both, burn-in included.
    sweeps
        Of both, burn-in included.
    note
        What else a reader must know.
    """

    variances: Float64
    mean: Float64
    sd: Float64
    same: NDArray[Any] | None
    seconds: float
    sweeps: int
    note: str = ""


@numba.njit(cache=True, error_model="numpy")
def _plain_loop(
    offsets: Any, neighbours: Any, weights: Any, count: Any, mean: Any, spread: float, components: int, prior: Any,
    tolerance: float, seed: int, traces: Any, burn_in: int, total: Any, squares: Any, same: Any,
) -> None:  # fmt: skip
    """One site after the other; sums for means, deviations and the probability of each edge by counting."""
    np.random.seed(seed)
    n = mean.size
    x = mean.copy()
    pixels = count.sum()
    v = s2 = ((count * (mean - (count * mean).sum() / pixels) ** 2).sum() + spread) / pixels
    for sweep in range(burn_in + traces.shape[1]):
        for i in range(n):
            precision, pull = count[i] / s2, count[i] * mean[i] / s2
            for k in range(offsets[i], offsets[i + 1]):
                precision += weights[k] / v
                pull += weights[k] * x[neighbours[k]] / v
            x[i] = pull / precision + np.random.normal() / np.sqrt(precision)
        roughness = misfit = 0.0
        for i in range(n):
            misfit += count[i] * (mean[i] - x[i]) ** 2
            for k in range(offsets[i], offsets[i + 1]):
                if neighbours[k] > i:
                    roughness += weights[k] * (x[i] - x[neighbours[k]]) ** 2
        v = (prior[1] + roughness / 2) / np.random.gamma(prior[0] + (n - components) / 2)
        s2 = (prior[3] + (spread + misfit) / 2) / np.random.gamma(prior[2] + pixels / 2)
        if sweep < burn_in:
            continue
        traces[0, sweep - burn_in], traces[1, sweep - burn_in] = v, s2
        edge = 0
        for i in range(n):
            total[i] += x[i] - mean[i]
            squares[i] += (x[i] - mean[i]) ** 2
            for k in range(offsets[i], offsets[i + 1]):
                if neighbours[k] > i:
                    same[edge] += abs(x[i] - x[neighbours[k]]) <= tolerance
                    edge += 1


def weights_of(model: CarModel) -> Float64:
    """Weights of the edges."""
    return np.ones(len(model.edges)) if model.weights is None else model.weights.astype(np.float64)


def rows_of(model: CarModel) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int64]]:
    """Neighbours of every node in compressed sparse rows (offsets, neighbours), and the edge to each of them."""
    ends = np.concatenate([model.edges, model.edges[:, ::-1]])
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    offsets = np.zeros(len(model.count) + 1, np.int64)
    np.cumsum(np.bincount(ends[:, 0], minlength=len(model.count)), out=offsets[1:])
    return offsets, ends[order, 1], order % len(model.edges)


def plain_loop(
    model: CarModel, rows: tuple[Any, Any, Any], burn_in: int, draws: int, tolerance: float, seed: int = 0
) -> tuple[Float64, Float64, Float64, Float64]:
    """Single-site Gibbs in the order of the sites: traces (2, draws) of v and s2, means, deviations, probabilities.

    ``rows`` are those of `rows_of`.
    """
    p, n = model.priors, len(model.count)
    prior = np.array([p.smoothness_shape, p.smoothness_rate, p.noise_shape, p.noise_rate])
    traces, total, squares = np.empty((2, draws)), np.zeros(n), np.zeros(n)
    offsets, neighbours, edge_of = rows
    same = np.zeros(len(model.edges), np.int32)
    _plain_loop(
        offsets, neighbours, weights_of(model)[edge_of], model.count, model.mean, float(model.spread.sum()),
        model.components, prior, tolerance, seed, traces, burn_in, total, squares, same,
    )  # fmt: skip
    shift = total / draws
    deviation = np.sqrt(np.maximum(squares / draws - shift**2, 0))
    return traces, model.mean + shift, deviation, same / draws


def jags(model: CarModel, burn_in: int, draws: int) -> Chains:
    """Run JAGS on the model in a process of its own; compiling the graph is told in the note, not timed.

    Raises
    ------
    Unsuitable
        When it is not installed, the graph is too large or it takes too long.
    """
    if shutil.which("jags") is None:
        raise Unsuitable("not installed: Debian package jags")
    if len(model.count) > LARGEST_JAGS:
        raise Unsuitable(f"not tried beyond {LARGEST_JAGS:,} nodes, each an object of its own in it")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_input(_reference(), model, folder, burn_in, draws)
        try:
            done = subprocess.run(
                ["jags", "commands"], cwd=folder, capture_output=True, text=True, check=False, timeout=JAGS_PATIENCE
            )
        except subprocess.TimeoutExpired:
            doing = f"2 × {burn_in + draws} sweeps" if (folder / "before").exists() else "compiling the graph"
            raise Unsuitable(f"did not end in {JAGS_PATIENCE:.0f} s: {doing}") from None
        if done.returncode or "rror" in done.stdout + done.stderr:
            raise Unsuitable(f"failed: {(done.stdout + done.stderr).strip().splitlines()[-1]}")
        traces = [np.loadtxt(folder / f"CODAchain{chain}.txt", usecols=1).reshape(2, draws) for chain in (1, 2)]
        tables = [np.loadtxt(folder / f"CODAtable{chain}.txt", usecols=1).reshape(2, -1) for chain in (1, 2)]
        start, before, after = ((folder / mark).stat().st_mtime for mark in ("commands", "before", "after"))
    mean, variance = np.swapaxes(tables, 0, 1)
    note = f"and {before - start:.1f} s to compile the graph"
    return Chains(np.stack(traces), mean, np.sqrt(variance), None, after - before, 2 * (burn_in + draws), note)


def _reference() -> ModuleType:
    loader = SourceFileLoader("reference_car", str(REFERENCE))
    spec = spec_from_loader(loader.name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    loader.exec_module(module)
    return module


def _write_input(script: ModuleType, model: CarModel, folder: Path, burn_in: int, draws: int) -> None:
    edges, several = model.edges, np.flatnonzero(model.count > 1)
    data = {"N": len(model.count), "n": model.count, "m": model.mean}
    data |= {"M": several.size, "several": several + 1, "S": np.maximum(model.spread[several], 1e-9)}
    data |= {"E": len(edges), "a": edges[:, 0] + 1, "b": edges[:, 1] + 1, "w": weights_of(model)}
    # the count's rate must stay positive on a graph of any size
    text = script.MODEL.replace("10000 +", f"{10_000 + 10 * len(edges)} +")
    (folder / "model").write_text(text.replace("E - N + 1", f"E - N + {model.components}"))
    (folder / "data").write_text("".join(script.as_r(name, value) for name, value in data.items()))
    commands = ['model in "model"', 'data in "data"', "compile, nchains(2)"]
    # as ours do, chains start at the data with the variance of all heights
    precision = float(1 / model.mean.var())
    for chain in (1, 2):
        start = {"x": model.mean, "precision.field": precision, "precision.pixel": precision, ".RNG.seed": chain}
        text = "".join(script.as_r(name, value) for name, value in start.items())
        (folder / f"start{chain}").write_text(text + '".RNG.name" <- "base::Mersenne-Twister"\n')
        commands.append(f'parameters in "start{chain}", chain({chain})')
    # JAGS has no clock, but files have
    commands += ["initialize", 'parameters to "before"', f"update {burn_in}", "monitor v", "monitor s2"]
    commands += ["monitor x, type(mean)", "monitor x, type(variance)"]
    commands += [f"update {draws}", 'parameters to "after"', "coda *"]
    (folder / "commands").write_text("\n".join(commands) + "\n")
