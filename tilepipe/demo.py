"""The demo: a synthetic city, its streets, their score, and pictures."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from tilepipe.options import RunOptions
from tilepipe.passes import Progress, Silent

BUFFER = 3.0
"""Buffer of the demo's score in metres."""


def compile_kernels() -> None:
    """Run `streets` once on a small drawn cross, so that its compiled kernels lie in the disk cache."""
    import numpy as np
    import xarray as xr

    from tilepipe.streets import streets

    row, column = np.mgrid[:256, :256].astype(np.float32)
    street = (np.abs(row - column) < 12) | (np.abs(row - 128) < 10)
    grey = np.where(street, 40, 160) + np.random.default_rng(0).normal(0, 5, street.shape).astype(np.float32)
    grey[60:63, 60:63] = np.nan
    array = xr.DataArray(grey.astype(np.float32), dims=("y", "x"), coords={"y": 5e6 - row[:, 0], "x": 5e5 + column[0]})
    with tempfile.TemporaryDirectory() as folder:
        streets(array, out=Path(folder) / "run", crs="EPSG:32633")


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
    from tilepipe.evaluate import evaluate
    from tilepipe.report import report
    from tilepipe.streets import streets
    from tilepipe.synthetic import City, write_city

    progress = progress or Silent()
    start = time.perf_counter()
    # the first time the kernels of streets are compiled beside those of the city
    compiling = subprocess.Popen([sys.executable, "-c", "from tilepipe.demo import compile_kernels; compile_kernels()"])
    city = write_city(
        out / "city",
        City(seed=seed, rows=size, columns=size),
        layers=("intensity",),
        progress=partial(progress, "city"),
    )
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
    lines += [f"  {path}" for path in report(run)]
    return "\n".join(lines)
