"""``edges``: optimisers of labels beside graph cuts, lines beside their peers, the pipeline from end to end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.edges import accuracy as edge_accuracy
from benchmarks.edges import lines as edge_lines
from benchmarks.edges import optimiser_picture, optimisers, pipeline
from benchmarks.edges.accuracy import Accuracy
from benchmarks.edges.instances import aerial, instances
from benchmarks.edges.optimisers import Solved
from benchmarks.edges.pipeline import NAMES, EdgeScene, Outcome
from benchmarks.measure.commands import scratch_folder, stage_table
from benchmarks.measure.contest import Case, Measurement, Unsuitable, measure
from benchmarks.measure.machine import Machine, describe_machine
from benchmarks.measure.tables import LEGEND, RESULTS, comparison, save
from benchmarks.measure.watch import watch
from benchmarks.objects.scenes import DATA

SIZE, QUICK_SIZE = 4096, 512
IMAGE_SIZE, QUICK_IMAGE_SIZE = 4096, 256
"""Side of the image of optimisers and lines; the photograph has 1050 × 3150 pixels."""
ACCURACY_SIZE, QUICK_ACCURACY_SIZE = 2048, 512
SWEEPS, QUICK_SWEEPS = (20, 100), (10,)
PARTS = ("optimisers", "lines", "pipeline")
LARGEST_OPTIMISED = 1024
"""Side of the image of optimisers in pixels."""
PATIENCE, OPTIMISER_PATIENCE = 10.0, 1.0
"""Seconds; a slower call is timed once.  An optimiser is a matter of energies first."""

AIMS = (
    f"Aims, on all cores: {optimisers.AIM:g} Mpx/s of parallel HCF for the levels of an image at K = 2, "
    f"{edge_lines.AIM:g} Mpx/s of lines given levels, {pipeline.AIM:g} Mpx/s of the pipeline."
)


@dataclass
class Measured:
    """Everything that was measured; ``absent`` names what is not here, and why."""

    solved: list[list[Solved]] = field(default_factory=list)
    lines: list[tuple[Case, list[Measurement]]] = field(default_factory=list)
    accuracy: list[Accuracy] = field(default_factory=list)
    outcomes: list[Outcome] = field(default_factory=list)
    scenes: list[EdgeScene] = field(default_factory=list)
    absent: list[str] = field(default_factory=list)

    def skip(self, what: str, reason: Unsuitable) -> str:
        """Note what is not here."""
        self.absent.append(f"Skipped: {what}, {reason}.")
        print(self.absent[-1])
        return self.absent[-1]


@dataclass(frozen=True)
class _Options:
    """What all parts are told, as the arguments of `run_edges`."""

    machine: Machine
    repetitions: int
    peers: bool
    data: Path
    scratch: Path | None


def run_edges(
    *,
    sizes: Sequence[int] = (SIZE,),
    image_size: int = IMAGE_SIZE,
    accuracy_size: int = ACCURACY_SIZE,
    sweeps: Sequence[int] = SWEEPS,
    scenes: Sequence[str] = NAMES,
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
        Sides of the pipeline's synthetic cities in pixels.
    image_size
        Side of the image of optimisers, of which they see at most `LARGEST_OPTIMISED`, and lines.
    accuracy_size
        Side of the city whose edges are scored.
    sweeps
        Lengths of annealing.
    scenes
        Of the pipeline, some of `benchmarks.edges.pipeline.NAMES`.
    parts
        Some of `PARTS`.
    repetitions
        Rounds after the warm-up.
    peers
        Whether the peers run too.
    data
        Folder of the photograph and of the Potts energy.
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
    print(AIMS)
    found, page = Measured(), [AIMS, ""]
    options = _Options(machine, repetitions, peers, data, scratch)
    if "optimisers" in parts:
        page += _optimisers(found, options, image_size, sweeps)
        if results is not None:
            path = optimiser_picture.picture(found.solved, results)
            page += [f"![Energy against time of every optimiser]({path.name})", ""]
            print(path)
    if "lines" in parts:
        page += _lines(found, options, image_size, accuracy_size)
    if "pipeline" in parts:
        page += _pipeline(found, options, sizes, scenes)
    if results is not None:
        save("edges", machine, page, results)
    return found


def _optimisers(found: Measured, options: _Options, size: int, sweeps: Sequence[int]) -> list[str]:
    grey = aerial(min(size, LARGEST_OPTIMISED), options.data)
    image = f"Image: {grey.source}, {grey.values.shape[0]} × {grey.values.shape[1]} pixels."
    absent = []
    for make in instances(grey, options.data):
        try:
            instance = make()
        except Unsuitable as reason:
            absent.append(found.skip("the Potts energy", reason))
            continue
        found.solved.append(
            optimisers.run_instance(
                instance, workers=options.machine.cores, repetitions=options.repetitions, peers=options.peers,
                sweeps=sweeps, patience=OPTIMISER_PATIENCE,
            )
        )  # fmt: skip
    table = optimisers.optimiser_table(found.solved, options.machine)
    notes = [*optimisers.notes(found.solved), *(f"- {line}" for line in absent)]
    return [*table.shown(), image, optimisers.LEGEND, "", *notes, ""]


def _lines(found: Measured, options: _Options, size: int, accuracy_size: int) -> list[str]:
    grey, workers = aerial(size, options.data), options.machine.cores
    for make in edge_lines.CASES:
        case = make(grey)
        timed = measure(
            case, workers=workers, repetitions=options.repetitions, peers=options.peers, patience=PATIENCE
        )  # fmt: skip
        found.lines.append((case, timed))
    table = comparison(
        f"Edges and lines, {grey.source}, {grey.values.shape[0]} × {grey.values.shape[1]} pixels", found.lines,
        options.machine,
    )  # fmt: skip
    page = [*table.shown(), edge_lines.LEGEND, LEGEND, ""]
    for accuracy in edge_accuracy.run_accuracy(accuracy_size, workers=workers, peers=options.peers):
        found.accuracy.append(accuracy)
        print(f"accuracy: {accuracy.name}", flush=True)
    table = edge_accuracy.accuracy_table(found.accuracy, accuracy_size)
    return [*page, *table.shown(), edge_accuracy.LEGEND, ""]


def _pipeline(found: Measured, options: _Options, sizes: Sequence[int], scenes: Sequence[str]) -> list[str]:
    absent = []
    for name in scenes:
        for size in sizes if name == "city" else (0,):
            try:
                _run_scene(found, options, name, size)
            except Unsuitable as reason:
                absent.append(found.skip(f"scene {name}", reason))
    notes = [f"- {scene.name}: {scene.source}." for scene in found.scenes] + [f"- {line}" for line in absent]
    if not found.outcomes:
        return [*notes, ""]
    speed = pipeline.speed_table(found.outcomes, options.machine)
    return [*speed.shown(), pipeline.LEGEND, "", *notes, "", *stage_table(found.outcomes).shown()]


def _run_scene(found: Measured, options: _Options, name: str, size: int) -> None:
    with scratch_folder(options.scratch) as folder:
        scene = pipeline.prepare(name, folder, size=size, workers=options.machine.cores, data=options.data)
        if not found.scenes:
            # the first start compiles
            watch(pipeline.ours(scene, folder / "run"))
        found.scenes.append(scene)
        found.outcomes.append(_told(pipeline.run_ours(scene, folder / "run", options.repetitions)))
        if options.peers:
            for outcome in pipeline.run_rivals(scene, folder, options.repetitions):
                found.outcomes.append(_told(outcome))


def _told(outcome: Outcome) -> Outcome:
    seconds = f"skipped: {outcome.skipped}" if outcome.skipped else f"{outcome.seconds:.3g} s"
    print(f"{outcome.scene.name}: {outcome.contestant.replace('**', '')}, {seconds}", flush=True)
    return outcome
