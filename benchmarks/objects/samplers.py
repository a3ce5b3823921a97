"""The sampler of `objects` beside a plain numba loop and JAGS: node updates and effective draws per second."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.kernels.surfaces import city_model, sweep_traffic
from benchmarks.measure.contest import Call, Case, Contestant, Unsuitable
from benchmarks.measure.tables import Table, number
from benchmarks.objects.chains import Chains, Float64, jags, plain_loop, rows_of
from tilepipe_kernels.car_model.convergence import effective_sample_size
from tilepipe_kernels.car_model.model import CarModel
from tilepipe_kernels.car_model.sampler import sample

NODES = (1_000, 10_000, 100_000, 1_000_000)
LEAVES_PER_PIXEL = 0.1
"""Of the synthetic city, about."""
TOLERANCE = 0.5
LOOP, COUNTING = "plain numba loop", "**tilepipe Gibbs, counting**"
UPDATES_AIM, EFFECTIVE_AIM = 30.0, 2.0
"""Million node updates a second on all cores; effective draws a second, times the plain loop's."""

LEGEND = (
    "The graph is that of a synthetic city's leaves. Every contestant runs two chains, learns both variances, v "
    "(smoothness) and s2 (noise), and keeps every sweep after a burn-in of a tenth; rates count the burn-in. "
    "An *effective draw* is worth an independent one: of v and s2 by their autocorrelations (Vehtari et al. 2021); of "
    "heights and of the edges' probabilities, the independent draws that would scatter as little as the two chains "
    "differ, over all nodes and edges. *times the loop* is the least of the ratios for v, s2 and heights; *per draw* "
    "the effective draws of v in a kept sweep. "
    "*counting* estimates probabilities by counting draws, as the loop does; the default averages the probabilities "
    "given all other heights, which costs more and tells more. *exact* draws all heights at once (perturb-and-MAP). "
    "All sample one posterior, so *v* and *s2*, the posterior means, must agree."
)


def model_of(nodes: int) -> CarModel:
    """The model of a city that has about so many leaves."""
    side = math.sqrt(nodes / LEAVES_PER_PIXEL)
    return city_model(max(64, 64 * round(side / 64)))


def sweeps_case(nodes: int, updates: float = 4e7) -> Case:
    """Sweeps of which none is kept, so many that ``updates`` nodes are drawn."""
    model = model_of(nodes)
    sweeps = max(10, round(updates / len(model.count)))

    def ours() -> Call:
        return lambda workers: sample(model, burn_in=sweeps - 2, draws=2, tolerance=TOLERANCE, workers=workers)

    def plain() -> Call:
        rows = rows_of(model)
        return lambda workers: plain_loop(model, rows, sweeps - 2, 2, TOLERANCE)

    return Case(
        f"sweeps, {len(model.count):,} nodes",
        "M updates/s",
        len(model.count) * sweeps / 1e6,
        sweeps * sweep_traffic(model),
        [
            Contestant("tilepipe Gibbs", ours, ours=True, note="colouring included"),
            Contestant("plain numba loop", plain, serial=True),
        ],
        aim=UPDATES_AIM,
    )


@dataclass(frozen=True)
class Sampled:
    """Chains of one contestant on one graph, or why there are none."""

    nodes: int
    name: str
    chains: Chains | None
    skipped: str = ""


def effective_draws(chains: Chains) -> Float64:
    """Effective draws of v, s2, heights and edge probabilities in both chains; NaN for what was not estimated."""
    found = [effective_sample_size(chains.variances[:, which]) for which in (0, 1)]
    found.append(_worth((chains.sd**2).mean(axis=0), chains.mean))
    if chains.same is None:
        found.append(math.nan)
    else:
        probability = chains.same.mean(axis=0)
        found.append(_worth(probability * (1 - probability), chains.same))
    return np.array(found)


def _worth(variance: NDArray[Any], means: NDArray[Any]) -> float:
    """Independent draws whose mean would scatter as that of two chains does, over all nodes or edges."""
    scatter = ((means[0] - means[1]) ** 2 / 4).sum()
    return float(variance.sum() / scatter) if scatter > 0 else math.nan


def run_samplers(
    nodes: int, *, workers: int, peers: bool = True, updates: float = 1e8, slow_updates: float = 4e6
) -> list[Sampled]:
    """Run every contestant once on one graph.

    Parameters
    ----------
    nodes
        Wanted number of nodes.
    workers
        Threads of ours.
    peers
        Whether plain loop and JAGS run too.
    updates, slow_updates
        Node updates kept of a Gibbs chain, and of exact draws and JAGS, which are slower; at least so many sweeps
        are made that effective draws can be told.
    """
    model = model_of(nodes)
    count = len(model.count)
    draws, few = (int(np.clip(budget / count, 50, 2000)) for budget in (updates, slow_updates))
    gibbs = partial(_ours, model, draws, workers=workers)
    contestants: list[tuple[str, Callable[[], Chains]]] = [
        (COUNTING, partial(gibbs, counting=True)),
        ("**tilepipe Gibbs**", gibbs),
        ("**tilepipe exact**", partial(_ours, model, few, method="exact", workers=workers)),
    ]
    if peers:
        contestants += [(LOOP, partial(_plain, model, draws)), ("JAGS", partial(jags, model, max(few // 10, 1), few))]
    found = []
    for name, run in contestants:
        try:
            found.append(Sampled(count, name, run()))
        except Unsuitable as reason:
            found.append(Sampled(count, name, None, str(reason)))
    return found


def _plain(model: CarModel, draws: int) -> Chains:
    rows = rows_of(model)
    return _two_chains(lambda burn_in, draws, seed: plain_loop(model, rows, burn_in, draws, TOLERANCE, seed), draws)


def _ours(
    model: CarModel, draws: int, *, workers: int, method: Literal["gibbs", "exact"] = "gibbs", counting: bool = False
) -> Chains:
    def run(burn_in: int, draws: int, seed: int) -> tuple[Any, ...]:
        found = sample(
            model, burn_in=burn_in, draws=draws, seed=seed, tolerance=TOLERANCE, method=method, counting=counting,
            workers=workers,
        )  # fmt: skip
        return np.stack([found.smoothness, found.noise]), found.mean, found.sd, found.same

    return _two_chains(run, draws)


def _two_chains(run: Callable[[int, int, int], tuple[Any, ...]], draws: int) -> Chains:
    burn_in = max(draws // 10, 1)
    run(0, 2, 0)
    start = time.perf_counter()
    found = [run(burn_in, draws, seed) for seed in (1, 2)]
    seconds = time.perf_counter() - start
    variances, mean, sd, same = (np.stack(both) for both in zip(*found, strict=True))
    return Chains(variances, mean, sd, same, seconds, 2 * (burn_in + draws))


def sampler_table(found: Sequence[Sampled]) -> Table:
    """One row per contestant and graph."""
    columns = (
        "nodes", "sampler", "draws", "sweeps/s", "M updates/s", "v per s", "s2 per s", "heights per s",
        "probabilities per s", "times the loop", "per draw", "v", "s2", "note",
    )  # fmt: skip
    table = Table("Effective draws per second of the samplers", columns)
    for nodes in dict.fromkeys(sampled.nodes for sampled in found):
        group = [sampled for sampled in found if sampled.nodes == nodes]
        loop = next((s.chains for s in group if s.name == LOOP), None)
        for row, sampled in enumerate(group):
            head = f"{nodes:,}" if row == 0 else ""
            if sampled.chains is None:
                table.rows.append([head, sampled.name, *[""] * 11, f"skipped: {sampled.skipped}"])
            else:
                table.rows.append([head, sampled.name, *_cells(sampled, sampled.chains, loop)])
    return table


def _cells(sampled: Sampled, chains: Chains, loop: Chains | None) -> list[str]:
    rate, draws = chains.sweeps / chains.seconds, chains.variances.shape[2]
    effective = effective_draws(chains)
    per_second = effective / chains.seconds
    times, notes = "", [chains.note]
    if loop is not None and chains is not loop:
        least = float((per_second / (effective_draws(loop) / loop.seconds))[:3].min())
        times = f"{number(least)} ×"
        if sampled.name == COUNTING:
            notes.insert(0, f"aim {EFFECTIVE_AIM:g} ×: {'reached' if least >= EFFECTIVE_AIM else 'missed'}")
    v, s2 = chains.variances.mean(axis=(0, 2))
    return [
        f"2 × {draws:,}",
        number(rate),
        number(rate * sampled.nodes / 1e6),
        *(number(float(value)) for value in per_second),
        times,
        number(float(effective[0] / (2 * draws))),
        f"{v:.4g}",
        f"{s2:.4g}",
        "; ".join(filter(None, notes)),
    ]
