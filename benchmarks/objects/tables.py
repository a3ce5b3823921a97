"""The tables of the pipeline `objects` beside its plain rival, and in words what they show."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence

from benchmarks.measure.machine import Machine
from benchmarks.measure.tables import Table, number
from benchmarks.objects.pipeline import LARGEST_CHECKED, OURS, Outcome
from benchmarks.objects.quality import BOUNDARY, BUILDING_HEIGHT, SMALLEST_BLOCK, PartitionScore
from tilepipe.evaluate.polygons import AreaScore

TRAFFIC = 8
"""Bytes of a pixel that must be moved: its height read, its number written."""

SPEED = (
    "The whole command, from the start of the interpreter to the last file; medians. *times* is the rate beside the "
    "rival's, *one core* that with `--workers 1` (the rival has no other), *peak* the most memory held, children "
    f"included, *bandwidth* the time in which {TRAFFIC} bytes a pixel could be copied. *covered* is the polygons' area "
    "in valid pixels. *coverage*: `shapely.coverage_is_valid`, which asks that neighbours share every vertex of their "
    f"border, so that a change of it leaves no slit; tested up to {LARGEST_CHECKED:g} Mpx. "
    "*Rival* is `benchmarks/objects/rivals.py`: 3 × 3 median, `cc3d.connected_components(delta=0.5)`, "
    "`cc3d.dust`, `rasterio.features.shapes`; it leaves small objects out, "
    "and its polygons follow the pixels' sides, where ours are simplified."
)

PARTITION = (
    "Both part the plane, so neither says what is a building. What a partition allows is measured: the *best union* of "
    f"a true block (buildings that touch are one block, from {SMALLEST_BLOCK:g} m²) is all objects that lie in it by "
    "more than half. *found*: blocks whose best union has an IoU of 0.5 or more; *IoU*: its mean over the blocks; "
    "*objects per block*: over-segmentation, 1 is best; *under-segmentation*: area of objects across the blocks' "
    "borders, per area of the blocks (Neubert & Protzel 2012), 0 is best. The last three compare all unions with all "
    f"blocks: IoU by area, share of the true boundary within {BOUNDARY:g} m of theirs (recall), of theirs within "
    f"{BOUNDARY:g} m of the true one (precision)."
)

BUILDINGS = (
    "Here nothing is chosen by the truth. Buildings are told by the pipeline itself (`buildings.parquet`, where a run "
    f"publishes it) or by a plain rule: the object's mean is {BUILDING_HEIGHT:g} m or more above the ground "
    "(`tilepipe_kernels.heights.ground`), which takes trees along. Completeness, correctness and quality are "
    f"by object, from {SMALLEST_BLOCK:g} m², at half the area (Rutzinger et al. 2009), touching ones dissolved; "
    f"*boundary* is the RMS distance of the result's boundary where it is within {BOUNDARY:g} m of the true one."
)

# Name, value and whether more is better, of what is compared in words; 1 % of difference counts as none.
_MEASURES: tuple[tuple[str, Callable[[PartitionScore], float], bool], ...] = (
    ("blocks found", lambda score: score.found, True),
    ("IoU of the best union", lambda score: score.iou, True),
    ("IoU by area", lambda score: score.union.iou, True),
    ("boundary recall", lambda score: score.union.truth_to_result.near, True),
    ("boundary precision", lambda score: score.union.result_to_truth.near, True),
    ("objects per block", lambda score: score.objects_per_block, False),
    ("under-segmentation", lambda score: score.under_segmentation, False),
)
_ALIKE = 0.01


def _by_scene(outcomes: Sequence[Outcome]) -> Iterator[list[Outcome]]:
    for _, group in itertools.groupby(outcomes, lambda outcome: outcome.scene.name):
        yield list(group)


def speed_table(outcomes: Sequence[Outcome], machine: Machine) -> Table:
    """Speed, memory and form of the result."""
    columns = (
        "scene", "contestant", "Mpx/s", "times", "one core", "seconds", "peak GiB", "bandwidth", "objects", "covered",
        "coverage", "load",
    )  # fmt: skip
    table = Table("Objects from heights, end to end", columns)
    for group in _by_scene(outcomes):
        rival = next((o.rate for o in group if o.contestant != OURS and o.runs), math.nan)
        for row, outcome in enumerate(group):
            scene = f"{outcome.scene.name}, {number(outcome.scene.megapixels)} Mpx" if row == 0 else ""
            cells = (
                [f"skipped: {outcome.skipped}", *[""] * 9] if outcome.skipped else _speed_cells(outcome, rival, machine)
            )
            table.rows.append([scene, outcome.contestant, *cells])
    return table


def _speed_cells(outcome: Outcome, rival: float, machine: Machine) -> list[str]:
    rate, megapixels = outcome.rate, outcome.scene.megapixels
    share = rate * 1e6 * TRAFFIC / machine.bandwidth
    scored = outcome.partition is not None
    form = {True: "valid", False: "no coverage", None: "not tested"}[outcome.coverage]
    return [
        number(rate),
        f"{number(rate / rival)} ×" if outcome.contestant == OURS and not math.isnan(rival) else "",
        number(megapixels / outcome.single.seconds) if outcome.single else number(rate),
        f"{outcome.seconds:.1f}",
        f"{max(run.peak for run in outcome.runs) / 2**30:.2f}",
        f"{share:.1%}" if share >= 0.001 else "< 0.1%",
        f"{outcome.objects:,}" if scored else "not scored",
        percent(outcome.covered) if scored else "",
        (form if outcome.valid else "invalid polygons") if scored else "",
        f"{outcome.load:.1f}",
    ]


def percent(share: float) -> str:
    """A share in per cent; a dash where it is undefined."""
    return "–" if math.isnan(share) else f"{100 * share:.1f} %"


def partition_table(outcomes: Sequence[Outcome]) -> Table:
    """The partitions against the true blocks."""
    columns = (
        "scene", "contestant", "blocks", "found", "IoU", "objects per block", "under-segmentation", "IoU by area",
        "recall", "precision",
    )  # fmt: skip
    table = Table("What the partitions allow", columns)
    for group in _by_scene(outcomes):
        scored = [(outcome, outcome.partition) for outcome in group if outcome.partition is not None]
        for row, (outcome, score) in enumerate(scored):
            union = score.union
            table.rows.append(
                [
                    outcome.scene.name if row == 0 else "",
                    outcome.contestant,
                    f"{score.blocks:,}",
                    percent(score.found),
                    percent(score.iou),
                    number(score.objects_per_block),
                    percent(score.under_segmentation),
                    percent(union.iou),
                    percent(union.truth_to_result.near),
                    percent(union.result_to_truth.near),
                ]
            )
    return table


def building_table(outcomes: Sequence[Outcome]) -> Table:
    """What is taken for a building against what is one."""
    columns = (
        "scene", "contestant", "buildings", "IoU by area", "completeness", "correctness", "quality", "boundary m",
    )  # fmt: skip
    table = Table("Buildings", columns)
    for group in _by_scene(outcomes):
        rows = [(outcome, *found) for outcome in group for found in outcome.buildings.items()]
        for row, (outcome, way, score) in enumerate(rows):
            scene = outcome.scene.name if row == 0 else ""
            table.rows.append([scene, outcome.contestant, way, *_building_cells(score)])
    return table


def _building_cells(score: AreaScore) -> list[str]:
    large, rms = score.large_objects, score.result_to_truth.rms
    shares = (score.iou, large.completeness, large.correctness, large.quality)
    return [*(percent(share) for share in shares), "–" if math.isnan(rms) else f"{rms:.2f}"]


def verdict(outcomes: Sequence[Outcome]) -> list[str]:
    """For each scene one sentence on where the Bayesian merge is better than the rival and one on where it is not."""
    lines = []
    for group in _by_scene(outcomes):
        scored = {outcome.contestant: outcome for outcome in group if outcome.partition is not None}
        mine, other = scored.pop(OURS, None), next(iter(scored.values()), None)
        if mine is not None and other is not None:
            lines += [f"**{group[0].scene.name}.** {_comparison(mine, other)}", ""]
    return lines


def _comparison(mine: Outcome, other: Outcome) -> str:
    better, alike, worse = list[str](), list[str](), list[str]()
    assert mine.partition is not None and other.partition is not None
    for name, value, more in _MEASURES:
        a, b = value(mine.partition), value(other.partition)
        gain = (a - b if more else b - a) / max(abs(a), abs(b), 1e-9)
        text = f"{name} ({_figure(name, a)} against {_figure(name, b)})"
        (alike if abs(gain) < _ALIKE else better if gain > 0 else worse).append(text)
    (better if mine.rate > other.rate else worse).append(
        f"speed ({number(mine.rate)} against {number(other.rate)} Mpx/s)"
    )
    said = (("Better", better), ("Alike", alike), ("Worse", worse))
    return " ".join(f"{how}: {', '.join(found)}." for how, found in said if found)


def _figure(name: str, value: float) -> str:
    return number(value) if name.startswith("objects") else percent(value)
