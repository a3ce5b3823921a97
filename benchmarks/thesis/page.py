"""The experiments of Barbosa (1994) made again: ``scripts/reproduce_edges`` writes ``results/edges-thesis.md``.

Two scenes, reciprocal and quadratic potential, sequential and integrated, 2 and 4 levels are sixteen runs; beside
them the classical method of Nevatia & Babu.  What comes out is written down as it is.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from benchmarks.measure.machine import Machine, describe_machine
from benchmarks.measure.tables import RESULTS, Table, save
from benchmarks.thesis import tables
from benchmarks.thesis.photographs import DATA, photographs
from benchmarks.thesis.pictures import picture
from benchmarks.thesis.results import Results, draw, gather
from benchmarks.thesis.runs import FORMS, OURS, PLAIN, RUNS, Form, classical, execute
from benchmarks.thesis.scenes import DRAWINGS, Scene
from benchmarks.thesis.verdicts import CLOSE, MOST, Finding, judge
from tilepipe.engine.tiles.allocator import keep_freed_memory

DRAWS = 5
REPETITIONS = 3
LESS_NOISE = (0.5, 0.25)


def _introduction(draws: int, skipped: Sequence[str], left: int) -> str:
    return "\n\n".join([
        "The thesis of Barbosa (1994) finds the borders of roads in aerial photographs by two coupled Markov random "
        "fields, labels of grey and line elements between pixels, whose energy U it minimises by Highest Confidence "
        "First (HCF). It tries a *reciprocal* and a *quadratic* potential, labels and lines one after the other "
        "(*sequential*) and at once (*integrated*), 2 and 4 grey levels, on two photographs of 190 × 150 pixels; it "
        "judges by eye. This page makes the same runs, with the thesis's parameters (α = γ = ξ = ζ = 0.5, β = 1, "
        "σ = 0.3), on scenes whose edges are known. `scripts/reproduce_edges` makes the page again.",
        "Its photographs are not to be had. Scene 1 is drawn after its image 1 (a road that forks, well contrasted), "
        f"scene 2 after its image 2 (a motorway junction, low contrast); figures are means over {draws} draws of the "
        "noise. See `benchmarks/thesis/scenes.py`. Of parts of two other photographs no truth is known: energies, "
        "number of edges and pictures alone.",
        "Every run is made in three forms. *plain*: serial HCF with all sites uncommitted at first, as the thesis "
        "describes it. It does not say how it treats ground where nothing speaks for or against a line; here a line "
        "then runs straight on, since to break off costs γ and to go on costs nothing. *sure*: the same, but elements "
        "between equal labels are 0 at first, which stops that. *ours*: *sure* in parallel, tilepipe's default. "
        f"Sites that still wanted to change when the rounds were over, in all runs together: {left}.",
        "**How it is scored.** Within 1 pixel, without the outer 4 pixels of the image. *precision*, *recall*, *F1*: "
        "against the borders of roads, what the thesis seeks; *object …*: against the edges of everything that is "
        "drawn, roads, fields, houses, trees and cars. *false px*: length of what is detected elsewhere; cracks count "
        "π/4 and pixels of chains 1.11 pixels of length, the means over all directions. *unbroken px*: how long the "
        "stretch of border found without a gap is around a point of the borders, in the mean over all points, those "
        "not found counting 0; a dotted line, every second crack of it missing, passes for unbroken. *mean line "
        "px*: mean length of the connected detected lines, which tells dotted lines from whole ones.",
        f"**How it is judged.** Runs are compared in pairs that differ in one thing. Conclusions 1 and 2: a pair is "
        "won if F1 or the unbroken stretch is better and neither is worse, lost the other way round, open otherwise "
        f"(within {CLOSE:.0%} is equal). Conclusion 3: likewise with the false length and F1, for the run of the "
        "thesis's figures 24 and 25 (sequential, reciprocal, 2 levels) against Nevatia & Babu with the threshold at "
        "the corner of their histogram, and with the threshold of the same recall. A conclusion *holds* where at least "
        f"{MOST:.0%} of the pairs are won, *does not* where at most {1 - MOST:.0%} are.",
        "**What the energy asks for.** Two things follow from it before anything is run. With 2 levels the potentials "
        "differ in strength alone: two unequal neighbours cost β more than equal ones in the quadratic, β/2 in the "
        "reciprocal one. And along a border that is a staircase of single cracks between adjacent levels, all cracks "
        "together cost ξ = 0.5 each for their corners, no cracks α = 0.5 each, every second crack 0.25: with the "
        "thesis's weights the best line field of a sloping border is a dotted line.",
        *skipped,
    ])  # fmt: skip


def _pictures(results: Sequence[Results], folder: Path) -> str:
    parts = ["## Pictures, after figures 15 to 25", ""]
    for result in results:
        for form in (PLAIN, OURS):
            path = picture(result, form, folder)
            print(path)
            parts += [f"![{result.scene.title}, {form.title}]({path.name})", ""]
    return "\n".join(parts)


def _warm_up(scene: Scene) -> None:
    for form in FORMS:
        for run in RUNS:
            execute(run, form, scene.grey[:40, :40])
    classical(scene.grey[:40, :40])


def reproduce(
    *,
    draws: int = DRAWS,
    repetitions: int = REPETITIONS,
    less_noise: Sequence[float] = LESS_NOISE,
    data: Path = DATA,
    results: Path | None = RESULTS,
    machine: Machine | None = None,
) -> list[Table]:
    """Make all runs, show the tables and write the page with its pictures.

    Parameters
    ----------
    draws
        Draws of the noise of each scene.
    repetitions
        Of each run, for its time.
    less_noise
        Factors on noise and texture under which the conclusions are judged again.
    data
        Folder of the photographs.
    results
        For the page; None: no page and no pictures.
    machine
        Where this runs; None: looked up.

    Returns
    -------
    list of Table
        Those of the page.
    """
    machine = machine or describe_machine()
    scenes = [draw(make(), draws) for make in DRAWINGS]
    _warm_up(scenes[0][0])
    drawn = [gather(each, repetitions=repetitions) for each in scenes]
    real, skipped = [], []
    for scene in photographs(data):
        if isinstance(scene, str):
            skipped.append(scene)
            print(scene)
        else:
            real.append(gather([scene], repetitions=repetitions))
    quieter: dict[tuple[float, Form], tuple[Finding, Finding, Finding]] = {}
    for factor in less_noise:
        softer = [gather(draw(make(), draws, factor), repetitions=1) for make in DRAWINGS]
        quieter |= {(factor, form): judge(softer, form) for form in FORMS}
    made = [
        tables.verdict_table(drawn),
        tables.time_table(drawn),
        *(tables.score_table(drawn, form) for form in FORMS),
        tables.classical_table(drawn),
    ]
    made += [tables.noise_table(quieter)] if quieter else []
    made += [tables.photograph_table(real)] if real else []
    for table in made:
        table.show()
    if results is not None:
        text = _introduction(draws, skipped, tables.unresolved([*drawn, *real]))
        pictures = _pictures([*drawn, *real], results)
        save("edges-thesis", machine, [text, "", *(table.markdown() for table in made), pictures], results)
    return made


def main() -> None:
    """Parse the arguments and run."""
    keep_freed_memory()
    parser = argparse.ArgumentParser(prog="reproduce_edges", description="The experiments of Barbosa (1994) again.")
    parser.add_argument("--draws", type=int, default=DRAWS, help="draws of the noise of each scene")
    parser.add_argument("--rounds", type=int, default=REPETITIONS, help="repetitions of each run, the fastest counts")
    parser.add_argument("--data", type=Path, default=DATA, help="folder of the photographs")
    parser.add_argument("--results", type=Path, default=RESULTS, help="folder for the page and its pictures")
    parser.add_argument("--no-page", action="store_true", help="only show the tables")
    arguments = parser.parse_args()
    reproduce(
        draws=arguments.draws,
        repetitions=arguments.rounds,
        data=arguments.data,
        results=None if arguments.no_page else arguments.results,
    )


if __name__ == "__main__":
    main()
