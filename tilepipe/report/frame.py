"""A picture of a run: maps of the same ground beside each other, framed by header, legends and scale bar."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from tilepipe.report.finished_run import Bounds, FinishedRun
from tilepipe.report.map import DPI, INK, Map

QUICKLOOK, DETAIL = "quicklook.png", "quicklook_detail.png"
LONGEST_SIDE = 1800
"""Most pixels along a map."""
_SMALL = 1000
"""Rasters of fewer pixels are enlarged to this, but not to blurs; no picture is narrower."""
_MARGIN, _HEADER, _FOOTER = 40, 110, 80
"""Pixels around the maps: left and right, above, below."""
_CAPTION, _GAP = 30, 30
"""Pixels above a map for its caption, and between two maps."""
_BAR, _LONGEST_BAR = 110, 500
"""Pixels for colour bars and their labels beside a map, and along such a bar."""


class Picture:
    """Maps of a part of a run, to be drawn on and saved.

    Parameters
    ----------
    run
        Where the picture goes.
    bounds
        The part; by default all.
    captions
        Of the maps, from left to right.
    longest
        Most pixels along a map.
    enlarged
        A map has this many pixels, however few the raster has.
    bars
        Leave room for colour bars.
    """

    def __init__(
        self,
        run: FinishedRun,
        bounds: Bounds | None = None,
        *,
        captions: Sequence[str] = ("",),
        longest: int = LONGEST_SIDE,
        enlarged: bool = False,
        bars: bool = False,
    ) -> None:
        self.run, self.bounds = run, bounds or run.bounds
        shape = run.size(self.bounds)
        scale = longest / max(shape)
        if not enlarged:
            scale = min(scale, max(1.0, _SMALL / max(shape)))
        self.height, self.width = (max(round(side * scale), 1) for side in shape)
        across = len(captions) * self.width + (len(captions) - 1) * _GAP + bars * _BAR
        self.wide = max(across + 2 * _MARGIN, _SMALL)
        self.high = self.height + _HEADER + _FOOTER + any(captions) * _CAPTION
        self.figure = Figure(figsize=(self.wide / DPI, self.high / DPI), dpi=DPI, facecolor="white")
        FigureCanvasAgg(self.figure)
        self.left = (self.wide - across) / 2
        self.right = self.left + across - bars * _BAR
        self.maps = []
        for number, caption in enumerate(captions):
            left = self.left + number * (self.width + _GAP)
            axes = self.figure.add_axes(self._place(left, _FOOTER, self.width, self.height))
            self.maps.append(Map(axes, run, self.bounds, (self.height, self.width)))
            self._write(left, self.high - _HEADER - 15, caption, fontsize=13, fontweight="bold")

    def save(self, name: str, title: str, facts: str) -> Path:
        """Write the picture into the folder of the run, with what its maps need to be read; returns the path."""
        self._write(self.left, self.high - 46, title, fontsize=20, fontweight="bold")
        self._write(self.left, self.high - 82, facts, fontsize=11.5, color="#57606f")
        for number, drawn in enumerate(self.maps):
            left = self.left + number * (self.width + _GAP)
            if entries := drawn.legend + drawn.last:
                self._draw_legend(left, _FOOTER / 2 + bool(drawn.swatches) * 14, entries)
            for colours, text in drawn.swatches:
                self._draw_swatches(left, _FOOTER / 2 - 16, colours, text)
        self._draw_bars(self.maps[-1])
        self._draw_scale_bar()
        with self.run.adding(name) as aside:
            self.figure.savefig(aside, dpi=DPI, metadata={"Software": None})
        return self.run.folder / name

    def _place(self, left: float, bottom: float, width: float, height: float) -> tuple[float, float, float, float]:
        """A rectangle of pixels in fractions of the figure."""
        return left / self.wide, bottom / self.high, width / self.wide, height / self.high

    def _write(self, left: float, middle: float, text: str, **style: Any) -> None:
        self.figure.text(left / self.wide, middle / self.high, text, **{"color": INK, "va": "center"} | style)

    def _draw_box(self, left: float, bottom: float, width: float, height: float, colour: str, line: float) -> None:
        x, y, wide, high = self._place(left, bottom, width, height)
        self.figure.add_artist(Rectangle((x, y), wide, high, facecolor=colour, edgecolor=INK, linewidth=line))

    def _draw_legend(self, left: float, middle: float, entries: Sequence[Artist]) -> None:
        self.figure.legend(
            handles=entries,
            loc="center left",
            bbox_to_anchor=(left / self.wide - 0.006, middle / self.high),
            ncols=len(entries),
            frameon=False,
            fontsize=11.5,
            labelcolor=INK,
            columnspacing=1.6,
        )

    def _draw_swatches(self, left: float, middle: float, colours: Sequence[str], text: str) -> None:
        """Draw a row of small boxes and a text behind it."""
        side = min(22, 320 / len(colours))
        for place, colour in enumerate(colours):
            self._draw_box(left + place * side, middle - 7, side, 14, colour, 0.5)
        self._write(left + len(colours) * side + 10, middle, text, fontsize=11.5)

    def _draw_bars(self, drawn: Map) -> None:
        """Draw colour bars above each other beside a map, the first at its foot."""
        if not drawn.bars:
            return
        gap = 40
        long = min((self.height - gap * (len(drawn.bars) - 1)) / len(drawn.bars), _LONGEST_BAR)
        for number, (colours, label, opacity) in enumerate(drawn.bars):
            place = self._place(self.right + 24, _FOOTER + number * (long + gap), 16, long)
            bar = self.figure.colorbar(colours, cax=self.figure.add_axes(place), label=label, alpha=opacity)
            bar.outline.set_edgecolor(INK)

    def _draw_scale_bar(self) -> None:
        """Draw a two-part bar of a round number of metres, ending below the right end of the maps."""
        ground = (self.bounds[2] - self.bounds[0]) * self.run.metres
        length = round_length(ground * min(0.2, 240 / self.width))
        wide = self.width * length / ground
        for part, colour in ((0, INK), (1, "white")):
            self._draw_box(self.right - wide + part * wide / 2, _FOOTER / 2 - 12, wide / 2, 7, colour, 1)
        text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
        for place, label, side in ((self.right - wide, "0", "center"), (self.right, text, "right")):
            self._write(place, _FOOTER / 2 + 3, label, fontsize=11, ha=side, va="baseline")


def round_length(longest: float) -> float:
    """Return the largest 1, 2 or 5 times a power of ten that is no more than `longest`.

    Examples
    --------
    >>> from tilepipe.report.frame import round_length
    >>> round_length(437.0)
    200.0
    """
    power = 10.0 ** math.floor(math.log10(longest))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= longest * (1 + 1e-12))
