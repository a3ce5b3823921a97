"""Picture of the optimisers of `edges`: how far above the least energy each ended, against its seconds."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from benchmarks.edges.optimisers import ICM, PARALLEL, Solved
from tilepipe.io.files.atomic import atomic_write
from tilepipe.report.map import INK

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.transforms import Bbox

NAME = "edges-optimisers.png"

_ACROSS = 2
_DPI = 110
_PIXELS = _DPI / 72
"""Of a point."""
_PANEL = 6.4, 3.7
"""Inches, wide and high."""
_HEADER = 0.65
"""Inches."""
_OURS, _PEER, _PALE = "#0b62a8", "#b3470f", "#aab2bd"
_LEAST_SHARE = 1e-4
"""Share of ICM's distance below which the axis is linear, so that the least energy itself has a place."""
_TICKS = {0: "least", 1e-4: "0.01 %", 1e-3: "0.1 %", 1e-2: "1 %", 1e-1: "10 %", 1: "100 %"}
_DISTANCES = (9, 16, 24, 33, 43, 54, 66, 79)
"""Points from a mark to its label; the nearest free place is taken."""
_DIRECTIONS = ((1, 0), (-1, 0), (0.7, 0.7), (0.7, -0.7), (-0.7, 0.7), (-0.7, -0.7), (0, 1), (0, -1))


def picture(solved: Sequence[Sequence[Solved]], folder: Path) -> Path:
    """Draw one panel per instance; returns the path."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    folder.mkdir(parents=True, exist_ok=True)
    path = folder / NAME
    down = -(-len(solved) // _ACROSS)
    figure = Figure(figsize=(_ACROSS * _PANEL[0], down * _PANEL[1] + _HEADER), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    inch = 1 / figure.get_figheight()
    title = "Optimisers of labels: energy above the least that any of them found, as a share of ICM's, against time"
    figure.text(0.5, 1 - 0.22 * inch, title, fontsize=12.5, fontweight="bold", color=INK, ha="center", va="center")
    for place, (sign, words, colour) in enumerate(
        (("●", "tilepipe, on all cores", _OURS), ("■", "PyMaxflow and gco, which know one core", _PEER))
    ):
        across = 0.5 + (0.02 if place else -0.02)
        figure.text(
            across, 1 - 0.48 * inch, f"{sign} {words}", fontsize=10, color=colour, va="center",
            ha="left" if place else "right",
        )  # fmt: skip
    panels = list(figure.subplots(down, _ACROSS, squeeze=False).flat)
    for axes in panels[len(solved) :]:
        axes.set_visible(False)
    for axes, group in zip(panels, solved, strict=False):
        _draw(axes, [each for each in group if not math.isnan(each.energy)])
    figure.tight_layout(rect=(0, 0, 1, 1 - _HEADER * inch), h_pad=1.6, w_pad=1.6)
    # labels look for their places once the marks have theirs
    for axes, group in zip(panels, solved, strict=False):
        _label(axes, _marks([each for each in group if not math.isnan(each.energy)]))
    with atomic_write(path) as aside:
        figure.savefig(aside, dpi=_DPI, metadata={"Software": None})
    return path


def _marks(group: Sequence[Solved]) -> list[tuple[Solved, float, float]]:
    """Each contestant with its seconds and its distance from the least energy, that of ICM being 1."""
    least = min(each.energy for each in group)
    unit = next((each.energy for each in group if each.name == ICM), least) - least
    unit = unit or 1.0
    return [(each, each.case.work / each.measurement.rate(each.case), (each.energy - least) / unit) for each in group]


def _curves(marks: Sequence[tuple[Solved, float, float]]) -> list[list[tuple[float, float]]]:
    """Marks of one optimiser that was given several lengths."""
    runs = ([mark[1:] for mark in marks if mark[0].name.startswith(name)] for name in ("annealing", "messages"))
    return [run for run in runs if len(run) > 1]


def _draw(axes: Axes, group: Sequence[Solved]) -> None:
    marks = _marks(group)
    axes.set_xscale("log")
    axes.set_yscale("symlog", linthresh=_LEAST_SHARE, linscale=0.6)
    for run in _curves(marks):
        axes.plot(*zip(*run, strict=True), color=_OURS, linewidth=1, alpha=0.5, zorder=2)
    for each, seconds, above in marks:
        ours = each.measurement.contestant.ours
        axes.plot(seconds, above, "o" if ours else "s", color=_OURS if ours else _PEER, markersize=6, zorder=3)
    times = [seconds for _, seconds, _ in marks]
    axes.set_xlim(min(times) / 2.5, max(times) * 2.5)
    highest = max(above for *_, above in marks)
    axes.set_ylim(-0.7 * _LEAST_SHARE, max(4.0, 3 * highest))
    shown = {value: text for value, text in _TICKS.items() if value <= axes.get_ylim()[1]}
    axes.set_yticks(list(shown), list(shown.values()))
    axes.set_yticks([], minor=True)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.grid(True, which="major", color="#e3e7ec", linewidth=0.8)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    instance = group[0].instance
    rows, columns, _ = instance.unary.shape
    size = "" if f"{rows} × {columns}" in instance.name else f", {rows} × {columns} pixels"
    axes.set_title(f"{instance.name}{size}", fontsize=11, color=INK, loc="left")
    axes.set_xlabel("seconds", fontsize=9.5, color=INK)
    axes.tick_params(labelsize=9, colors=INK)


def _label(axes: Axes, marks: Sequence[tuple[Solved, float, float]]) -> None:
    """Name every mark where no other name, mark or curve is; a thin line leads to names that had to go far."""
    from matplotlib.transforms import Bbox

    places = axes.transData.transform([mark[1:] for mark in marks])
    taken = [Bbox.from_extents(x - 5, y - 5, x + 5, y + 5) for x, y in places]
    for run in _curves(marks):
        for one, other in itertools.pairwise(axes.transData.transform(run)):
            on = one + np.linspace(0, 1, 60)[:, None] * (other - one)
            taken += [Bbox.from_extents(x - 1, y - 1, x + 1, y + 1) for x, y in on]
    frame = axes.get_window_extent()
    # the leftmost first, so that names to the right of it find what is left
    for each, seconds, above in sorted(marks, key=lambda mark: (mark[1], mark[2])):
        ours = each.measurement.contestant.ours
        text = axes.annotate(
            each.name, (seconds, above), (0, 0), textcoords="offset points", va="bottom", fontsize=8.5, zorder=4,
            color=_OURS if ours else _PEER, fontweight="bold" if each.name == PARALLEL else "normal",
        )  # fmt: skip
        size = text.get_window_extent()
        at = axes.transData.transform((seconds, above))
        for corner, is_far in _places(size.width, size.height):
            box = Bbox.from_bounds(*(at + corner), size.width, size.height)
            if _inside(box, frame) and not any(box.overlaps(other) for other in taken):
                far = is_far
                break
        else:
            text.remove()
            continue
        taken.append(box.padded(2))
        text.set_position(tuple(corner / _PIXELS))
        if far:
            middle = box.x0 + box.width / 2, box.y0 + box.height / 2
            ends = axes.transData.inverted().transform([at, middle])
            axes.plot(*ends.T, color=_PALE, linewidth=0.7, zorder=1)


def _inside(box: Bbox, frame: Bbox) -> bool:
    return bool(frame.x0 <= box.x0 and box.x1 <= frame.x1 and frame.y0 <= box.y0 and box.y1 <= frame.y1)


def _places(width: float, height: float) -> Iterator[tuple[NDArray[np.float64], bool]]:
    """Lower left corners of a name of this size beside its mark, in pixels, the nearest first; whether it is far."""
    for distance in _DISTANCES:
        for x, y in _DIRECTIONS:
            back = np.array([width, height]) * [(1 - np.sign(x)) / 2, (1 - np.sign(y)) / 2]
            yield distance * _PIXELS * np.array([x, y]) - back, distance > 2 * _DISTANCES[0]
