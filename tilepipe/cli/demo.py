"""The demo: a synthetic city, its streets, their score, and pictures."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from tilepipe.engine.options import RunOptions
from tilepipe.engine.progress import Progress, Silent
from tilepipe.io.files.paths import local_output

BUFFER = 3.0
"""Buffer of the demo's score in metres."""


def compile_kernels() -> None:
    """Run `streets` once on a small scene, so that its compiled kernels lie in the disk cache."""
    import xarray as xr

    from tilepipe.pipelines.streets.pipeline import streets
    from tilepipe.pipelines.streets.warm_up import drawn_streets

    _, grey = drawn_streets()
    grey[60:63, 60:63] = np.nan
    y, x = 5e6 - np.arange(256.0), 5e5 + np.arange(256.0)
    array = xr.DataArray(grey, dims=("y", "x"), coords={"y": y, "x": x})
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
    from tilepipe.evaluate.lines import evaluate
    from tilepipe.pipelines.streets.pictures import pictures
    from tilepipe.pipelines.streets.pipeline import streets
    from tilepipe.pipelines.streets.warm_up import warm_up
    from tilepipe.synthetic import City, write_city

    progress = progress or Silent()
    out = local_output(out)
    start = time.perf_counter()
    # the first time the kernels of streets are compiled beside those of the city
    beside = [
        subprocess.Popen([sys.executable, "-P", "-c", f"from {module} import {name}; {name}()"])
        for module, name in (
            (__name__, compile_kernels.__name__),
            (warm_up.__module__, warm_up.__name__),
        )
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
