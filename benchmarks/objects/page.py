"""``objects``: the pipeline from end to end beside a plain rival, its sampler and its other kernels beside theirs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.measure.commands import scratch_folder, stage_table
from benchmarks.measure.contest import Case, Measurement, Unsuitable, measure
from benchmarks.measure.machine import Machine, describe_machine
from benchmarks.measure.tables import LEGEND, RESULTS, comparison, save
from benchmarks.measure.watch import watch
from benchmarks.objects.kernels import kernel_cases
from benchmarks.objects.pipeline import Outcome, ours, run_ours, run_rival
from benchmarks.objects.samplers import LEGEND as SAMPLERS
from benchmarks.objects.samplers import NODES, Sampled, run_samplers, sampler_table, sweeps_case
from benchmarks.objects.scenes import DATA, NAMES, ObjectScene, prepare
from benchmarks.objects.tables import BUILDINGS, PARTITION, SPEED, building_table, partition_table, speed_table, verdict

SIZE, QUICK_SIZE = 4096, 512
KERNEL_SIZE, QUICK_KERNEL_SIZE = 2048, 512
QUICK_NODES = (1_000, 10_000)
PARTS = ("pipeline", "samplers", "kernels")
UPDATES, QUICK_UPDATES = 1e8, 2e6
"""Node updates of a Gibbs chain; a sweep of the largest graph is a hundredth of them."""
SLOW = 25.0
"""Exact draws and JAGS are given so many times less."""


@dataclass
class Measured:
    """Everything that was measured; ``absent`` names the scenes that are not here, and why."""

    outcomes: list[Outcome] = field(default_factory=list)
    scenes: list[ObjectScene] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)
    sampled: list[Sampled] = field(default_factory=list)
    sweeps: list[tuple[Case, list[Measurement]]] = field(default_factory=list)
    kernels: list[tuple[Case, list[Measurement]]] = field(default_factory=list)


def run_objects(
    *,
    sizes: Sequence[int] = (SIZE,),
    scenes: Sequence[str] = NAMES,
    nodes: Sequence[int] = NODES,
    kernel_size: int = KERNEL_SIZE,
    updates: float = UPDATES,
    parts: Sequence[str] = PARTS,
    repetitions: int = 3,
    peers: bool = True,
    data: Path = DATA,
    scratch: Path | None = None,
    results: Path | None = RESULTS,
) -> Measured:
    """Measure, print each table as it is ready and write the page.

    Parameters
    ----------
    sizes
        Sides of the synthetic cities in pixels of half a metre.
    scenes
        Some of `NAMES`.
    nodes
        Sizes of the samplers' graphs.
    kernel_size
        Side of the kernels' scene in pixels.
    updates
        Node updates of a Gibbs chain.
    parts
        Some of `PARTS`.
    repetitions
        Rounds after the warm-up.
    peers
        Whether the peers run too.
    data
        Folder of the real surveys.
    scratch
        Folder for temporary files.
    results
        Folder of the page; None writes none.

    Returns
    -------
    Measured
    """
    machine = describe_machine()
    machine.announce()
    found, page = Measured(), list[str]()
    if "pipeline" in parts:
        for name in scenes:
            for size in sizes if name == "city" else (0,):
                _run_scene(found, name, size, machine, repetitions, peers, data, scratch)
        page += _pipeline_page(found, machine)
    if "samplers" in parts:
        for count in nodes:
            found.sampled += run_samplers(
                count, workers=machine.cores, peers=peers, updates=updates, slow_updates=updates / SLOW
            )
            case = sweeps_case(count, updates / 2)
            found.sweeps.append((case, measure(case, workers=machine.cores, repetitions=repetitions, peers=peers)))
        page += _sampler_page(found, machine)
    if "kernels" in parts:
        for make in kernel_cases(kernel_size):
            case = make()
            found.kernels.append((case, measure(case, workers=machine.cores, repetitions=repetitions, peers=peers)))
        table = comparison(f"Other kernels, scene of {kernel_size} × {kernel_size} pixels", found.kernels, machine)
        page += [*table.shown(), LEGEND, ""]
    if results is not None:
        save("objects", machine, page, results)
    return found


def _run_scene(
    found: Measured,
    name: str,
    size: int,
    machine: Machine,
    repetitions: int,
    peers: bool,
    data: Path,
    scratch: Path | None,
) -> None:
    with scratch_folder(scratch) as folder:
        try:
            scene = prepare(name, folder, size=size, workers=machine.cores, data=data)
        except Unsuitable as reason:
            found.absent.append(f"Skipped: scene {name}, {reason}.")
            print(found.absent[-1])
            return
        if not found.scenes:
            # the first start compiles
            watch(ours(scene, folder / "run"))
        found.scenes.append(scene)
        found.outcomes.append(run_ours(scene, folder / "run", repetitions))
        if peers:
            found.outcomes.append(run_rival(scene, folder / "rival", repetitions))


def _pipeline_page(found: Measured, machine: Machine) -> list[str]:
    outcomes = found.outcomes
    page = [f"- {scene.name}: {scene.source}." for scene in found.scenes]
    page += [f"- {line}" for line in found.absent] + [""]
    if not outcomes:
        return page
    words = verdict(outcomes)
    for line in words:
        print(line)
    page += [*speed_table(outcomes, machine).shown(), SPEED, ""]
    page += [*partition_table(outcomes).shown(), PARTITION, ""]
    page += ["### Where the Bayesian merge is better than the plain rival, and where it is not", "", *words]
    page += [*building_table(outcomes).shown(), BUILDINGS, ""]
    return page + stage_table(outcomes).shown()


def _sampler_page(found: Measured, machine: Machine) -> list[str]:
    sweeps = comparison("Sweeps of the samplers, none of them kept", found.sweeps, machine)
    return [*sampler_table(found.sampled).shown(), SAMPLERS, "", *sweeps.shown()]
