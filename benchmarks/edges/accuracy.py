"""Edges against the truth of the synthetic city: precision and recall within one pixel and two."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.edges import lines
from benchmarks.edges.instances import Grey, luminance
from benchmarks.measure.contest import Unsuitable
from benchmarks.measure.tables import Table
from benchmarks.objects.tables import percent
from tilepipe.synthetic import City, render_layers
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.mrf.edge_model import EdgeModel

TOLERANCES = (1.0, 2.0)
"""Pixels within which an edge fits."""

SHARES = (0.02, 0.05, 0.1, 0.15, 0.2)
"""Shares of strong gradients among which the truth chooses Canny's best."""

BELOW, RIGHT = 1, 2
"""Bits of the city's layer ``edges``."""

Points = NDArray[np.float64]

LEGEND = (
    "Aerial image of the synthetic city at half a metre. True are the outlines of buildings and the borders of "
    "streets where no tree hides them; all else that the image shows, such as roof ridges, shadows, cars, crowns and "
    "markings, counts as false, for everyone alike. *precision* is the share of detected points (cracks, pixels, "
    "every half pixel of a line) within the tolerance of a true crack, *recall* the share of true cracks within it of "
    "a detected point. Every method runs with its own defaults or, as the Canny detectors, with fixed shares of the "
    "gradients; *best share* is chosen by the truth and so is a bound, not a result."
)


@dataclass(frozen=True)
class Accuracy:
    """Scores of one contestant, by tolerance: precision and recall; or why there are none."""

    name: str
    ours: bool
    scores: dict[float, tuple[float, float]]
    skipped: str = ""


# ------------------------------------------------------------------------------------------------- points


def of_cracks(horizontal: NDArray[Any], vertical: NDArray[Any]) -> Points:
    """Middles of cracks, (n, 2); pixel (0, 0) reaches from 0 to 1."""
    h, v = np.argwhere(horizontal), np.argwhere(vertical)
    return np.concatenate([h + np.array([1, 0.5]), v + np.array([0.5, 1])])


def of_pixels(mask: NDArray[Any]) -> Points:
    """Centres of pixels."""
    return np.argwhere(mask) + 0.5


def of_segments(starts: Points, ends: Points) -> Points:
    """Points every half pixel of segments (n, 2)."""
    counts = np.maximum(np.ceil(2 * np.hypot(*(ends - starts).T)).astype(np.int64), 1)
    segment = np.repeat(np.arange(len(counts)), counts)
    along = (np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / counts[segment]
    return starts[segment] + along[:, None] * (ends - starts)[segment]


def of_detected(found: NDArray[np.float32]) -> Points:
    """Points of segments x, y, x, y as OpenCV counts: centres of pixels are whole numbers."""
    placed = found.astype(np.float64) + 0.5
    return of_segments(placed[:, 1::-1], placed[:, 3:1:-1])


def of_polylines(polylines: Polylines) -> Points:
    """Points of polylines through centres of pixels (row, column)."""
    inner = np.ones(max(len(polylines.vertices) - 1, 0), np.bool_)
    inner[polylines.offsets[1:-1] - 1] = False
    at = polylines.vertices + 0.5
    return of_segments(at[:-1][inner], at[1:][inner])


def score(found: Points, truth: Points, shape: tuple[int, int]) -> dict[float, tuple[float, float]]:
    """Precision and recall within `TOLERANCES`; points are rounded to half pixels."""
    distances = []
    for points, others in ((found, truth), (truth, found)):
        distances.append(_distances(points, others, shape))
    return {t: (_share(distances[0], t), _share(distances[1], t)) for t in TOLERANCES}


def _distances(points: Points, others: Points, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Distance of each point to the nearest of others, in pixels."""
    from scipy.ndimage import distance_transform_edt

    empty = np.ones((2 * shape[0] + 1, 2 * shape[1] + 1), np.bool_)
    places = [tuple(np.clip(np.rint(2 * p).astype(np.int64), 0, np.array(empty.shape) - 1).T) for p in (points, others)]
    if len(others) == 0:
        return np.full(len(points), np.inf)
    empty[places[1]] = False
    return np.asarray(distance_transform_edt(empty)[places[0]]) / 2


def _share(distance: NDArray[np.float64], tolerance: float) -> float:
    return float((distance <= tolerance).mean()) if distance.size else float("nan")


def f1(precision: float, recall: float) -> float:
    """Harmonic mean."""
    return 2 * precision * recall / (precision + recall) if precision + recall > 0 else 0.0


# ------------------------------------------------------------------------------------------------- contestants


def run_accuracy(size: int, *, workers: int, peers: bool) -> Iterator[Accuracy]:
    """Scores of every contestant on a city of ``size`` pixels a side."""
    layers = render_layers(City(rows=size, columns=size), ("aerial", "edges"))
    grey = Grey(luminance(layers["aerial"]), "synthetic city, aerial image")
    truth = of_cracks(layers["edges"] & BELOW, layers["edges"] & RIGHT)
    shape = (size, size)
    for name, find in _ours(grey, workers):
        yield Accuracy(name, True, score(find(), truth, shape))
    for name, find in _peers(grey) if peers else ():
        try:
            yield Accuracy(name, False, score(find(), truth, shape))
        except (ImportError, Unsuitable) as reason:
            yield Accuracy(name, False, {}, str(reason))
    for name, canny in (("OpenCV", lines.canny_opencv), ("skimage", lines.canny_skimage)) if peers else ():
        try:
            found = [score(of_pixels(canny(grey.bytes, share)()), truth, shape) for share in SHARES]
        except ImportError:
            continue
        yield Accuracy(f"{name} Canny, best share", False, max(found, key=lambda each: f1(*each[TOLERANCES[0]])))


def _ours(grey: Grey, workers: int) -> Iterator[tuple[str, Callable[[], Points]]]:
    for count in (2, 4):
        observed, model = grey.observed(count), EdgeModel(count)
        for name, fields in (("then lines", lines.sequential), ("integrated", lines.integrated)):
            title = f"tilepipe, {count} levels, {name}" if name == "integrated" else f"tilepipe, {count} levels {name}"
            yield title, lambda o=observed, m=model, f=fields: of_cracks(*(e == 1 for e in f(o, m, workers)[1:]))
    threshold = lines.babu_threshold(grey.values)
    yield "tilepipe Nevatia–Babu", lambda: of_polylines(lines.babu_lines(grey.values, threshold, workers))


def _peers(grey: Grey) -> Iterator[tuple[str, Callable[[], Points]]]:
    yield "OpenCV Canny", lambda: of_pixels(lines.canny_opencv(grey.bytes)())
    yield "skimage Canny", lambda: of_pixels(lines.canny_skimage(grey.bytes)())
    yield "OpenCV LSD", lambda: of_detected(lines.lsd(grey.bytes))
    yield "OpenCV EDLines", lambda: of_detected(lines.edlines(grey.bytes))


def accuracy_table(found: list[Accuracy], size: int) -> Table:
    """One row per contestant."""
    heads = [f"{what} {t:g} px" for t in TOLERANCES for what in ("precision", "recall", "F1")]
    table = Table(f"Edges against the truth, city of {size} × {size} pixels", ("contestant", *heads, "note"))
    for each in found:
        name = f"**{each.name}**" if each.ours else each.name
        cells = [percent(value) for t in each.scores for value in (*each.scores[t], f1(*each.scores[t]))]
        cells += [""] * (len(heads) - len(cells))
        table.rows.append([name, *cells, f"skipped: {each.skipped}" if each.skipped else ""])
    return table
