"""Pictures after figures 15 to 25 of Barbosa (1994): an image, and what every run made of it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.thesis.results import CORNER, Results
from benchmarks.thesis.runs import RUNS, Classical, Field, Form
from benchmarks.thesis.scenes import Points, Scene
from tilepipe.io.files.atomic import atomic_write
from tilepipe.report.map import INK

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Panel = NDArray[np.uint8]

_ZOOM = 2
_DPI = 100
_GAP, _TITLE, _HEADER = 12, 26, 52
_ACROSS = 4
_PAPER, _LINE, _OTHER = 255, 20, 165
"""Greys of the ground, of lines, and of edges that are no border of a road."""


def field_panel(horizontal: Field, vertical: Field) -> Panel:
    """Cracks between the pixels, each pixel being `_ZOOM` wide, as dark lines."""
    panel = np.full((_ZOOM * horizontal.shape[0], _ZOOM * horizontal.shape[1]), _PAPER, np.uint8)
    for rows, columns, down, right in (
        (*np.nonzero(horizontal == 1), _ZOOM, 0),
        (*np.nonzero(vertical == 1), 0, _ZOOM),
    ):
        for step in range(_ZOOM + 1):
            row = _ZOOM * rows + (down or step)
            column = _ZOOM * columns + (right or step)
            panel[np.minimum(row, panel.shape[0] - 1), np.minimum(column, panel.shape[1] - 1)] = _LINE
    return panel


def grey_panel(values: NDArray[Any], largest: float) -> Panel:
    """Grey values or labels up to a largest one."""
    grey = np.clip(np.rint(values * (255 / largest)), 0, 255).astype(np.uint8)
    return np.repeat(np.repeat(grey, _ZOOM, axis=0), _ZOOM, axis=1)


def truth_panel(scene: Scene) -> Panel:
    """True borders of roads dark, other true edges paler."""
    panel = np.full((_ZOOM * scene.grey.shape[0], _ZOOM * scene.grey.shape[1]), _PAPER, np.uint8)
    for lines, grey in ((scene.edges, _OTHER), (scene.roads, _LINE)):
        for points in lines:
            _dot(panel, points, grey)
    return panel


def _dot(panel: Panel, points: Points, grey: int) -> None:
    row, column = np.floor(_ZOOM * points).astype(np.int64).T
    panel[row, column] = grey


def elements_panel(lines: Classical, shape: tuple[int, int]) -> Panel:
    """Edge elements as dark pixels."""
    grey = np.full(shape, _PAPER, np.uint8)
    grey.reshape(-1)[lines.elements.pixel] = _LINE
    return np.repeat(np.repeat(grey, _ZOOM, axis=0), _ZOOM, axis=1)


def straight_panel(lines: Classical, shape: tuple[int, int]) -> Panel:
    """Straight lines of the traced chains."""
    panel = np.full((_ZOOM * shape[0], _ZOOM * shape[1]), _PAPER, np.uint8)
    for vertices in lines.polylines:
        corners = vertices.astype(np.float64) + 0.5
        for a, b in itertools.pairwise(corners):
            share = np.linspace(0, 1, 1 + int(2 * _ZOOM * np.abs(b - a).max()))[:, None]
            _dot(panel, a + share * (b - a), _LINE)
    return panel


def _panels(results: Results, form: Form) -> list[tuple[str, Panel]]:
    scene, classical = results.scene, results.classical[CORNER, ""].lines
    shape = (scene.grey.shape[0], scene.grey.shape[1])
    if scene.roads:
        second = ("truth: borders of roads dark", truth_panel(scene))
    else:
        labels = results.runs[form, RUNS[2]].outcome.labels
        second = ("labels of the first run with 4 levels", grey_panel(labels, 3))
    panels = [
        ("image", grey_panel(scene.grey, 255)),
        second,
        ("Nevatia–Babu: edge elements", elements_panel(classical, shape)),
        ("Nevatia–Babu: straight lines", straight_panel(classical, shape)),
    ]
    for run in RUNS:
        outcome = results.runs[form, run].outcome
        panels.append((run.title, field_panel(outcome.horizontal, outcome.vertical)))
    return panels


def _lay_out(title: str, panels: Sequence[tuple[str, Panel]]) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    high, wide = panels[0][1].shape
    down = -(-len(panels) // _ACROSS)
    width = _ACROSS * (wide + _GAP) + _GAP
    height = _HEADER + down * (high + _TITLE + _GAP)
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")
    FigureCanvasAgg(figure)
    figure.text(_GAP / width, 1 - 28 / height, title, fontsize=15, fontweight="bold", color=INK, va="center")
    for place, (name, panel) in enumerate(panels):
        row, column = divmod(place, _ACROSS)
        left = _GAP + column * (wide + _GAP)
        bottom = height - _HEADER - (row + 1) * (high + _TITLE) - row * _GAP
        axes = figure.add_axes((left / width, bottom / height, wide / width, high / height))
        axes.imshow(panel, cmap="gray", vmin=0, vmax=255, aspect="auto", interpolation="nearest")
        axes.set_xticks([])
        axes.set_yticks([])
        for spine in axes.spines.values():
            spine.set_color("#aab2bd")
        axes.set_title(name, fontsize=9.5, color=INK, loc="left", pad=5)
    return figure


def picture(results: Results, form: Form, folder: Path) -> Path:
    """Draw the image, the truth, the classical lines and the eight runs of a form; returns the path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"edges-thesis-{results.scene.key}-{form.key}.png"
    title = results.scene.title[0].upper() + results.scene.title[1:]
    figure = _lay_out(f"{title}; {form.title}", _panels(results, form))
    with atomic_write(path) as aside:
        figure.savefig(aside, dpi=_DPI, metadata={"Software": None})
    return path
