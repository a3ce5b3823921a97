"""The optimisers of labels beside each other and beside graph cuts: energy against time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.edges import cuts
from benchmarks.edges.instances import Field, Instance
from benchmarks.kernels.scene import Band, over_bands
from benchmarks.measure.contest import Build, Call, Case, Contestant, Measurement, measure
from benchmarks.measure.machine import Machine
from benchmarks.measure.tables import Table, number
from tilepipe_kernels.mrf.annealing import Annealing
from tilepipe_kernels.mrf.labels.minimise import halo
from tilepipe_kernels.mrf.search import DEFAULT, Search

AIM = 20.0
"""Mpx/s of `PARALLEL` on all cores for K = 2."""

PARALLEL, ICM = "parallel HCF", "ICM"
EXACT = "PyMaxflow, minimum cut"
COMPILED = 48
"""Side of the part of an instance on which ours is compiled before it is timed."""

MESSAGES = DEFAULT.messages, 4 * DEFAULT.messages
"""Rounds of messages."""

Kept = dict[str, NDArray[Any]]

LEGEND = (
    "Every contestant minimises the same energy; what it found is evaluated in float64. Ours runs as on tiles: a band "
    "of rows with its halo per core, the same labels as in one block. *seconds* are medians of all cores and of one; "
    "serial HCF and the peers know one core only; what takes long was run once, on all cores. *above the least* is the "
    "distance to the lowest energy that any of them reached, as a share of its absolute value; with PyMaxflow's cut "
    "that is the exact minimum, which such a cut finds for two labels or a convex potential. The reciprocal potential "
    "counts -β for each pair of equal labels, which makes |U| large: *of the gap* knows no such offset, it "
    "is the share of the way from the energy of ICM to the lowest. gco's costs are rounded to "
    f"{cuts.LARGEST_COST:.0e} parts of the largest."
)


@dataclass(frozen=True)
class Solved:
    """What one contestant made of an instance.

    Attributes
    ----------
    instance, case
        The problem and how it was timed.
    measurement
        Its times.
    energy
        Of its labels; NaN where it was skipped.
    """

    instance: Instance
    case: Case
    measurement: Measurement
    energy: float

    @property
    def name(self) -> str:
        """Of the contestant."""
        return self.measurement.contestant.name


def run_instance(
    instance: Instance, *, workers: int, repetitions: int, peers: bool, sweeps: Sequence[int], patience: float = 20.0
) -> list[Solved]:
    """Time every optimiser on an instance and evaluate what it found.

    Parameters
    ----------
    instance
        The problem.
    workers
        Threads of ours.
    repetitions
        Rounds after the warm-up.
    peers
        Whether the graph cuts run too.
    sweeps
        Lengths of annealing.
    patience
        Seconds; see `benchmarks.measure.contest.measure`.
    """
    kept: Kept = {}
    case = _case(instance, kept, sweeps)
    found = measure(case, workers=workers, repetitions=repetitions, peers=peers, patience=patience)
    return [
        Solved(
            instance, case, each, instance.energy(kept[name]) if (name := each.contestant.name) in kept else math.nan
        )
        for each in found
    ]


def _case(instance: Instance, kept: Kept, sweeps: Sequence[int]) -> Case:
    def ours(name: str, search: Search) -> Contestant:
        build, small = (_tiles(part, search) for part in (instance, instance.corner(COMPILED)))
        return Contestant(name, _keeping(build, name, kept), ours=True, serial=search.method == "serial", small=small)

    def peer(name: str, build: Build, note: str = "") -> Contestant:
        return Contestant(name, _keeping(build, name, kept), serial=True, note=note)

    def schedule(count: int) -> Annealing:
        # temperatures have the unit of the energy, for which the defaults take pairs of weight 1
        unit = 1.0 if instance.down is None else float(instance.down.max())
        return Annealing(count, hot=unit, cold=0.05 * unit)

    contestants = [
        ours(PARALLEL, DEFAULT),
        ours("serial HCF", Search("serial")),
        ours(ICM, Search("icm")),
        *(ours(f"annealing, {n} sweeps", Search("annealing", annealing=schedule(n))) for n in sweeps),
        *(ours(f"messages, {n} rounds", Search("messages", messages=n)) for n in MESSAGES),
        peer(EXACT, lambda: cuts.minimum_cut(instance), "exact"),
        peer("gco, one cycle", lambda: cuts.expansion(instance, 1), "α-expansion"),
        peer("gco, to the end", lambda: cuts.expansion(instance, -1), "α-expansion"),
    ]
    rows, columns, count = instance.unary.shape
    # grey values where U follows from them, else U; labels
    traffic = rows * columns * (4 * (1 if instance.model else count) + 1)
    aim = AIM if count == 2 and instance.model is not None else None
    return Case(instance.name, "Mpx/s", instance.megapixels, traffic, contestants, aim)


def _keeping(build: Build, name: str, kept: Kept) -> Build:
    """The same contestant, whose last labels stay."""

    def built() -> Call:
        call = build()

        def run(workers: int) -> Field:
            kept[name] = call(workers)
            return kept[name]

        return run

    return built


def _tiles(instance: Instance, search: Search) -> Build:
    def run(workers: int) -> Field:
        rows = instance.unary.shape[0]
        if search.method == "serial" or workers == 1:
            return instance.solve(slice(0, rows), search=search).labels

        def band(part: Band) -> Field:
            return instance.solve(part.padded, search=search).labels[part.core]

        return np.concatenate(over_bands(band, rows, halo(search), workers))

    return lambda: run


# ------------------------------------------------------------------------------------------------- table


def notes(solved: Sequence[Sequence[Solved]]) -> list[str]:
    """What a reader must know of the instances."""
    found = (group[0].instance for group in solved)
    return [f"- {instance.name}: {instance.note}." for instance in found if instance.note]


def optimiser_table(solved: Sequence[Sequence[Solved]], machine: Machine) -> Table:
    """One row per instance and optimiser."""
    columns = (
        "instance", "optimiser", "seconds", "one core", "Mpx/s", "peak MiB", "bandwidth", "energy", "above the least",
        "of the gap", "note",
    )  # fmt: skip
    table = Table("Optimisers of labels, energy against time", columns)
    for group in solved:
        least = min(each.energy for each in group if not math.isnan(each.energy))
        icm = next((each.energy for each in group if each.name == ICM), math.nan)
        for row, each in enumerate(group):
            instance = each.instance
            head = f"{instance.name}, {number(instance.megapixels)} Mpx" if row == 0 else ""
            name = f"**{each.name}**" if each.measurement.contestant.ours else each.name
            if each.measurement.skipped:
                table.rows.append([head, name, *[""] * 8, f"skipped: {each.measurement.skipped}"])
            else:
                table.rows.append([head, name, *_cells(each, least, icm, machine)])
    return table


def _cells(each: Solved, least: float, icm: float, machine: Machine) -> list[str]:
    measurement, case = each.measurement, each.case
    rate = measurement.rate(case)
    share = rate / case.work * case.traffic / machine.bandwidth
    notes = [measurement.contestant.note]
    if case.aim is not None and each.name == PARALLEL:
        notes.insert(0, f"aim {case.aim:g} Mpx/s: {'reached' if rate >= case.aim else 'missed'}")
    gap = (icm - each.energy) / (icm - least) if icm > least else math.nan
    return [
        f"{case.work / rate:.3g}",
        f"{case.work / measurement.rate(case, one_core=True):.3g}" if measurement.one_core else "–",
        number(rate),
        "" if measurement.peak is None else f"{measurement.peak / 2**20:.0f}",
        f"{share:.1%}" if share >= 0.001 else "< 0.1%",
        f"{each.energy:,.1f}",
        f"{(each.energy - least) / abs(least):.3%}",
        "–" if math.isnan(gap) else f"{gap:.0%}",
        "; ".join(filter(None, notes)),
    ]
