"""`tilepipe edges` and its plain rivals on aerial images: run, watched from outside, and scored."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.edges import rivals
from benchmarks.edges.accuracy import BELOW, RIGHT, f1, of_cracks, of_pixels, score
from benchmarks.edges.instances import PHOTOGRAPH
from benchmarks.measure.commands import Runs, pipeline, repeated_and_single, repeated_rival
from benchmarks.measure.contest import Unsuitable
from benchmarks.measure.machine import Machine, load_average
from benchmarks.measure.tables import Table, number
from benchmarks.objects.scenes import DATA
from benchmarks.objects.tables import percent
from tilepipe.synthetic import City, write_city

NAMES = ("city", "photograph")

OURS = "**tilepipe edges**"
RIVALS = {"opencv": "OpenCV Canny, findContours", "skimage": "skimage Canny, find_contours"}
AIM = 3.0
"""Mpx/s of the pipeline on all cores."""

TRAFFIC = 5
"""Bytes of a pixel that must be moved: three bands read, its level and its lines written."""
LARGEST_SCORED = 2048
"""Side of the part, from the first pixel on, that is scored."""
LARGEST_RIVAL = {"opencv": 300.0, "skimage": 70.0}
"""Megapixels of the largest image that a rival is given: it holds it many times over."""

EDGES = 3
"""Value of `lines.tif` where there is an edge below the pixel and one to its right; larger ones are nodata."""

LEGEND = (
    "The whole command, from the start of the interpreter to the last file; medians. *per core* is the rate by the "
    "number of cores, *one core* that with `--workers 1`, *times* the rate beside the fastest rival's, *peak* the most "
    f"memory held, children included, *bandwidth* the time in which {TRAFFIC} bytes a pixel could be copied. "
    "tilepipe writes levels, line field, polylines with their attributes and street borders, and Nevatia–Babu's lines; "
    "the rivals, `benchmarks/edges/rivals.py`, a mask of edges and its contours, from the whole image in memory. "
    "Precision and recall of the line field, or of the mask, are within 1 px of the city's true cracks."
)


@dataclass(frozen=True)
class EdgeScene:
    """An aerial image.

    Attributes
    ----------
    name
        As in the tables.
    raster
        Red, green and blue.
    shape
        Rows and columns.
    truth
        Raster of true cracks, where they are known.
    source
        Where the image comes from, for the page.
    """

    name: str
    raster: Path
    shape: tuple[int, int]
    truth: Path | None
    source: str

    @property
    def megapixels(self) -> float:
        """Number of pixels in millions."""
        return self.shape[0] * self.shape[1] / 1e6


def prepare(name: str, folder: Path, *, size: int, workers: int, data: Path = DATA) -> EdgeScene:
    """A scene, written into a folder where it is synthetic.

    Raises
    ------
    Unsuitable
        When the photograph is not there.
    """
    import rasterio

    if name == "city":
        city = City(rows=size, columns=size)
        paths = write_city(folder, city, layers=("aerial", "edges"), workers=workers, truth=False)
        source = f"synthetic, aerial image of {size}² pixels of {city.resolution:g} m"
        return EdgeScene(f"city {size}²", paths["aerial"], city.shape, paths["edges"], source)
    path = data / PHOTOGRAPH
    if not path.is_file():
        raise Unsuitable(f"no file {path}")
    with rasterio.open(path) as file:
        return EdgeScene("photograph", path, file.shape, None, f"{PHOTOGRAPH}, pixels of 1 ft")


@dataclass
class Outcome(Runs):
    """What one contestant did on one scene: also its number of lines, precision and recall within a pixel."""

    lines: int = 0
    precision: float = math.nan
    recall: float = math.nan


def ours(scene: EdgeScene, out: Path) -> list[str]:
    """The command of the pipeline."""
    return pipeline("edges", scene.raster, out)


def run_ours(scene: EdgeScene, out: Path, repetitions: int) -> Outcome:
    """Run `tilepipe edges` with its defaults; the first call of all should have compiled."""
    outcome = repeated_and_single(Outcome(OURS, scene, load=load_average()), ours(scene, out), out, repetitions)
    outcome.lines = _count(out / "edges.parquet")
    _score(outcome, out / "lines.tif", True)
    return outcome


def run_rivals(scene: EdgeScene, folder: Path, repetitions: int) -> Iterable[Outcome]:
    """Run `benchmarks.edges.rivals` both ways."""
    for way, name in RIVALS.items():
        outcome, out = Outcome(name, scene, load=load_average()), folder / way
        if scene.megapixels > LARGEST_RIVAL[way]:
            outcome.skipped = "holds the image in memory many times over"
            yield outcome
            continue
        command = [sys.executable, "-m", "benchmarks.edges.rivals", str(scene.raster), str(out), way]
        repeated_rival(outcome, command, out, repetitions)
        if not outcome.skipped:
            outcome.lines = _count(out / rivals.LINES)
            _score(outcome, out / rivals.MASK, False)
        yield outcome


def _count(path: Path) -> int:
    import pyarrow.parquet

    return int(pyarrow.parquet.read_metadata(path).num_rows)


def _score(outcome: Outcome, path: Path, cracks: bool) -> None:
    import rasterio
    from rasterio.windows import Window

    scene: EdgeScene = outcome.scene
    if scene.truth is None:
        return
    shape = (min(scene.shape[0], LARGEST_SCORED), min(scene.shape[1], LARGEST_SCORED))
    layers = []
    for each in (path, scene.truth):
        with rasterio.open(each) as file:
            layers.append(file.read(1, window=Window(0, 0, shape[1], shape[0])))
    found, truth = layers
    found[found > EDGES] = 0
    points = of_cracks(found & BELOW, found & RIGHT) if cracks else of_pixels(found)
    outcome.precision, outcome.recall = score(points, of_cracks(truth & BELOW, truth & RIGHT), shape)[1.0]


def speed_table(outcomes: Sequence[Outcome], machine: Machine) -> Table:
    """Speed, memory and scores."""
    columns = (
        "scene", "contestant", "Mpx/s", "per core", "one core", "times", "seconds", "peak GiB", "bandwidth", "lines",
        "precision", "recall", "F1", "load", "note",
    )  # fmt: skip
    table = Table("Edges of aerial images, end to end", columns)
    for name in dict.fromkeys(outcome.scene.name for outcome in outcomes):
        group = [outcome for outcome in outcomes if outcome.scene.name == name]
        rival = max((o.rate for o in group if o.contestant != OURS and o.runs), default=math.nan)
        for row, outcome in enumerate(group):
            scene = f"{name}, {number(outcome.scene.megapixels)} Mpx" if row == 0 else ""
            skipped = [*[""] * 12, f"skipped: {outcome.skipped}"]
            cells = skipped if outcome.skipped else _cells(outcome, rival, machine)
            table.rows.append([scene, outcome.contestant, *cells])
    return table


def _cells(outcome: Outcome, rival: float, machine: Machine) -> list[str]:
    rate, own = outcome.rate, outcome.contestant == OURS
    share = rate * 1e6 * TRAFFIC / machine.bandwidth
    scores = (outcome.precision, outcome.recall, f1(outcome.precision, outcome.recall))
    return [
        number(rate),
        number(rate / machine.cores),
        number(outcome.scene.megapixels / outcome.single.seconds) if outcome.single else "",
        f"{number(rate / rival)} ×" if own and not math.isnan(rival) else "",
        f"{outcome.seconds:.1f}",
        f"{max(run.peak for run in outcome.runs) / 2**30:.2f}",
        f"{share:.1%}" if share >= 0.001 else "< 0.1%",
        f"{outcome.lines:,}",
        *(percent(value) if not math.isnan(outcome.precision) else "" for value in scores),
        f"{outcome.load:.1f}",
        f"aim {AIM:g}: {'reached' if rate >= AIM else 'missed'}" if own else "",
    ]
