"""Parts of aerial photographs of the size of those in Barbosa (1994); their true edges are unknown."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.measure.contest import Unsuitable
from benchmarks.thesis.scenes import COLUMNS, ROWS, Scene

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
"""Where the photographs lie, beside the checkout; absent elsewhere."""


@dataclass(frozen=True)
class Photograph:
    """A part of a photograph: ``top`` and ``left`` in its pixels, of which each ours is a mean of ``reduction``²."""

    key: str
    title: str
    file: str
    top: int
    left: int
    reduction: int


PHOTOGRAPHS = (
    Photograph("autzen", "Autzen, a street and a junction, 0.9 m", "autzen_north/ortho_rgb_1ft.tif", 560, 1420, 3),
    Photograph(
        "vegas", "Las Vegas, a street beside a car park, 0.9 m",
        "spacenet_vegas/RGB-PanSharpen_AOI_2_Vegas_img0.tif", 300, 712, 3,
    ),
)  # fmt: skip


def read(photograph: Photograph, data: Path = DATA) -> Scene:
    """Luminance of a part of a photograph, 190 × 150 pixels.

    Raises
    ------
    Unsuitable
        When the photograph is not there.
    """
    import rasterio
    from rasterio.windows import Window

    from tilepipe.pipelines.edges.pass_bands import LUMINANCE

    path = data / photograph.file
    if not path.is_file():
        raise Unsuitable(f"{photograph.title}: not here, no file {path}")
    n = photograph.reduction
    window = Window(photograph.left, photograph.top, COLUMNS * n, ROWS * n)
    with rasterio.open(path) as raster:
        colours = raster.read([1, 2, 3], window=window).astype(np.float64)
    luminance = np.tensordot(LUMINANCE, colours, axes=1).reshape(ROWS, n, COLUMNS, n).mean(axis=(1, 3))
    return Scene(photograph.key, photograph.title, np.rint(luminance).astype(np.float32))


def photographs(data: Path = DATA) -> Iterable[Scene | str]:
    """The scenes of `PHOTOGRAPHS`; for one that is absent, a line that says so."""
    for photograph in PHOTOGRAPHS:
        try:
            yield read(photograph, data)
        except Unsuitable as reason:
            yield f"skipped: {reason}"
