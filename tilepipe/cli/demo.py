"""The demo: a synthetic city, its streets, their score, and pictures."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.options import RunOptions
from tilepipe.engine.progress import Progress, Silent

BUFFER = 3.0
"""Buffer of the demo's score in metres."""


def _drawn_street() -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """A small drawn cross of streets and its intensity."""
    row, column = np.mgrid[:256, :256].astype(np.float32)
    street = (np.abs(row - column) < 12) | (np.abs(row - 128) < 10)
    grey = np.where(street, 40, 160) + np.random.default_rng(0).normal(0, 5, street.shape)
    return street, grey.astype(np.float32)


def compile_kernels() -> None:
    """Run `streets` once on a small scene, so that its compiled kernels lie in the disk cache."""
    import xarray as xr

    from tilepipe.pipelines.streets.pipeline import streets

    grey = _drawn_street()[1]
    grey[60:63, 60:63] = np.nan
    y, x = 5e6 - np.arange(256.0), 5e5 + np.arange(256.0)
    array = xr.DataArray(grey, dims=("y", "x"), coords={"y": y, "x": x})
    with tempfile.TemporaryDirectory() as folder:
        streets(array, out=Path(folder) / "run", crs="EPSG:32633")


def compile_line_kernels() -> None:
    """Call the kernels of the pass `lines`, which `compile_kernels` reaches only after those of the passes before."""
    from tilepipe_kernels.network import skeleton, tracing
    from tilepipe_kernels.ridges.links import link_points
    from tilepipe_kernels.ridges.points import line_points
    from tilepipe_kernels.ridges.width import line_widths

    street, grey = _drawn_street()
    points = line_points(grey, 5.0, low=0.1, mask=street)
    links = np.zeros(street.shape, np.uint8)
    links[points.row, points.col] = link_points(points)
    tracing.trace(links, core=(0, 256, 0, 256), origin=(0, 0), width=256)
    axis, _ = skeleton.medial_axis_and_distance(street, cap=20, separation=8.0, origin=(0, 0))
    skeleton.skeleton_links(axis)
    line_widths(grey, points, 5.0, maximum_width=40.0)


def run_demo(out: Path, *, size: int = 2048, seed: int = 0, progress: Progress | None = None) -> str:
    """Make a synthetic city in ``out/city``, run `streets` into ``out/run``, score and draw it.

    Parameters
    ----------
    out
        Folder; made when missing, earlier demo results in it are replaced.
    size
        Side of the city in pixels of 0.5 m.
    seed
        Seed of the city.
    progress
        Told about the progress.

    Returns
    -------
    str
        What was made and how good it is, for people.
    """
    from tilepipe.evaluate.lines import evaluate
    from tilepipe.pipelines.streets.pictures import pictures
    from tilepipe.pipelines.streets.pipeline import streets
    from tilepipe.synthetic import City, write_city

    progress = progress or Silent()
    start = time.perf_counter()
    # the first time the kernels of streets are compiled beside those of the city
    beside = [
        subprocess.Popen([sys.executable, "-c", f"from tilepipe.cli.demo import {name}; {name}()"])
        for name in (compile_kernels.__name__, compile_line_kernels.__name__)
    ]
    city = write_city(
        out / "city",
        City(seed=seed, rows=size, columns=size),
        layers=("intensity",),
        progress=partial(progress, "city"),
    )
    for compiling in beside:
        compiling.wait()
    made = time.perf_counter()
    run = out / "run"
    layers = streets(city["intensity"], out=run, options=RunOptions(overwrite=True, tile=1024), progress=progress)
    done = time.perf_counter()
    lines = [
        f"synthetic city of {size} × {size} pixels: {city['intensity']} ({made - start:.1f} s)",
        f"streets in {done - made:.1f} s:",
        *(f"  {layer}" for layer in layers),
    ]
    for name in ("centerlines", "skeleton"):
        score = evaluate(run / f"{name}.parquet", city["centerlines"], BUFFER)
        lines.append(
            f"{name}: completeness {score.completeness:.1%}, correctness {score.correctness:.1%}, "
            f"RMS {score.rms_distance:.2f} m (within {BUFFER:g} m of the truth)"
        )
    lines.append("look at:")
    lines += [f"  {path}" for path in pictures(run)]
    return "\n".join(lines)
