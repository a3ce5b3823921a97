"""Whole pipelines on both backends, for `gpu.check`: what they publish, compared byte for byte, and their rates."""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

TILE = 4096
LAYERS = {"streets": "intensity", "objects": "height", "edges": "aerial"}
"""The synthetic layer that each pipeline reads."""


def pipeline_rows(size: int, in_one_line: Callable[[Exception], str]) -> Iterator[dict[str, Any]]:
    """One row of `benchmarks.gpu.check.Row` for each pipeline, or one that says what is missing."""
    try:
        import tilepipe
        from tilepipe.engine.options import RunOptions
        from tilepipe.synthetic import City, render
    except ImportError as error:
        yield {"name": "pipelines", "note": f"skipped: {error.name or error} is not installed"}
        return
    city = City(seed=0, rows=size, columns=size)
    for command, layer in LAYERS.items():
        values = render(city, layer)
        run = getattr(tilepipe, command)
        with tempfile.TemporaryDirectory(prefix="tilepipe-gpu-") as folder:
            runs = {}
            for backend in ("cupy", "numpy"):
                options = RunOptions(tile=min(TILE, size), backend=backend, memory=64 << 30, overwrite=True)
                out = Path(folder) / backend
                try:
                    # the first run compiles
                    run(_array(values), out=out, options=options)
                    start = time.perf_counter()
                    layers = run(_array(values), out=out, options=options)
                except Exception as error:
                    note = f"{backend}: {in_one_line(error)}"
                    yield {"name": command, "agreement": "FAILED", "note": note, "passed": False}
                    break
                runs[backend] = time.perf_counter() - start, layers
            else:
                yield _row(command, size, runs)


def _array(values: Any) -> Any:
    """The layer in memory, with a metric grid of half a metre."""
    import numpy as np
    import rioxarray  # noqa: F401
    import xarray as xr

    bands = np.atleast_3d(values)
    planes = np.moveaxis(bands, -1, 0) if bands.shape[2] > 1 else bands[None, ..., 0]
    rows, columns = planes.shape[1:]
    coordinates = {"y": 5e6 - 0.5 * np.arange(rows) - 0.25, "x": 5e5 + 0.5 * np.arange(columns) + 0.25}
    made = xr.DataArray(planes, dims=("band", "y", "x"), coords=coordinates, name="city")
    return (made[0] if len(planes) == 1 else made).rio.write_crs("EPSG:32633")


def _row(command: str, size: int, runs: dict[str, Any]) -> dict[str, Any]:
    (gpu_seconds, gpu), (cpu_seconds, cpu) = runs["cupy"], runs["numpy"]
    differ = [a.name for a, b in zip(gpu, cpu, strict=True) if _digest(a) != _digest(b)]
    pixels = size**2
    # probabilities of buildings go through logarithms, whose last digits are each device's own
    passed = not differ or command == "objects"
    return {
        "name": f"{command}, whole pipeline",
        "agreement": "the same bytes" if not differ else f"differs in {', '.join(differ)}",
        "rate": f"{pixels / gpu_seconds / 1e9:.3g}",
        "gain": f"{cpu_seconds / gpu_seconds:.1f} x",
        "passed": passed,
        "note": f"{pixels / 1e6 / gpu_seconds:.0f} Mpx/s with reading, reconciling and writing",
    }


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
