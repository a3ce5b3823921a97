"""The demo: a synthetic city, its streets, their score, and pictures."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path

from tilepipe.options import RunOptions
from tilepipe.passes import Progress, Silent

BUFFER = 3.0
"""Buffer of the demo's score in metres."""


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
    city = write_city(
        out / "city",
        City(seed=seed, rows=size, columns=size),
        layers=("intensity",),
        progress=partial(progress, "city"),
    )
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
