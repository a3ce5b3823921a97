"""Write a city to files, tile by tile."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.files.atomic import atomic_write
from tilepipe.io.files.manifest import Written, read_manifest, refuse_foreign, write_manifest
from tilepipe.io.files.paths import local_output
from tilepipe.synthetic.city import City
from tilepipe.synthetic.layers import LAYERS, render_layers
from tilepipe.synthetic.truth import truth_buildings, truth_centerlines
from tilepipe_kernels.city.layout import Window

#: Side of the internal blocks of the files in pixels.
BLOCK = 512
#: GDAL's cache in MiB; tiles are written whole, so it need only hold the blocks under way.
CACHE = 64 << 20
MANIFEST = "files.toml"
"""Names the files that cities have left in a folder."""
TRUTH = {"centerlines": truth_centerlines, "footprints": truth_buildings}
PROFILES: dict[str, dict[str, Any]] = {
    "height": {"dtype": "float32", "nodata": float("nan"), "predictor": 3},
    "intensity": {"dtype": "uint8", "nodata": 0, "predictor": 1},
    "aerial": {"dtype": "uint8", "count": 3, "photometric": "RGB", "interleave": "pixel", "predictor": 2},
    "streets": {"dtype": "uint8", "predictor": 1},
    "buildings": {"dtype": "int32", "predictor": 2},
    "edges": {"dtype": "uint8", "predictor": 1},
    "trees": {"dtype": "uint8", "predictor": 1},
}


def write_city(
    folder: str | Path,
    city: City,
    layers: Sequence[str] = tuple(LAYERS),
    tile: int = 1024,
    workers: int = 2,
    progress: Callable[[int, int], None] | None = None,
    truth: bool = True,
) -> dict[str, Path]:
    """Write layers of a city as GeoTIFF and its truth as GeoParquet; a file gets its name when it is whole.

    Parameters
    ----------
    folder
        Where to; made when missing.  Files that an earlier city has left there, as ``files.toml`` names them, are
        replaced.
    city
        The city.
    layers
        Which of ``LAYERS``.
    tile
        Side of the windows rendered at a time in pixels, a multiple of 512; memory grows with its square.
    workers
        Threads that render, and threads that compress.
    progress
        Called as ``progress(done, total)`` after every tile.
    truth
        Also write ``centerlines.parquet`` and ``footprints.parquet``.

    Returns
    -------
    dict
        The path of each layer, and of ``centerlines`` and ``footprints``.

    Raises
    ------
    InputError
        When a layer is unknown or the tile or the number of workers is unusable; or when a file of another origin
        would be replaced.

    Examples
    --------
    >>> from tilepipe.synthetic import City, write_city
    >>> written = write_city("city", City(rows=512, columns=512), layers=["intensity"], tile=512)
    >>> {name: path.name for name, path in written.items()}
    {'intensity': 'intensity.tif', 'centerlines': 'centerlines.parquet', 'footprints': 'footprints.parquet'}
    """
    for layer in layers:
        if layer not in LAYERS:
            raise InputError(f"unknown layer {layer!r}; choose from {', '.join(LAYERS)}")
    if tile < BLOCK or tile % BLOCK:
        raise InputError(f"tile must be a multiple of {BLOCK} pixels, not {tile}")
    if workers < 1:
        raise InputError(f"workers must be at least 1, not {workers}")
    folder = local_output(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = {layer: folder / f"{layer}.tif" for layer in layers}
    if truth:
        paths |= {name: folder / f"{name}.parquet" for name in TRUTH}
    known = read_manifest(folder / MANIFEST)
    refuse_foreign(folder, [path.name for path in paths.values()], known)
    with ExitStack() as stack:
        asides = {name: stack.enter_context(atomic_write(path)) for name, path in paths.items()}
        _write_rasters({layer: asides[layer] for layer in layers}, city, tile, workers, progress)
        for name in TRUTH if truth else ():
            TRUTH[name](city).to_parquet(asides[name])
        new = [Written.of(aside) for aside in asides.values()]
        # what is recorded must be known before it is there
        for path in paths.values():
            path.unlink(missing_ok=True)
        write_manifest(folder / MANIFEST, {file.name: file for file in (*known, *new)}.values())
    return paths


def _write_rasters(
    paths: dict[str, Path], city: City, tile: int, workers: int, progress: Callable[[int, int], None] | None
) -> None:
    """Render tiles in threads and write them in order, so that the files do not depend on the threads."""
    import rasterio
    from rasterio.windows import Window as RasterWindow

    windows = list(_windows(city, tile)) if paths else []
    with ExitStack() as stack:
        stack.enter_context(rasterio.Env(GDAL_CACHEMAX=CACHE))
        files = {
            layer: stack.enter_context(rasterio.open(path, "w", **_profile(city, layer, workers)))
            for layer, path in paths.items()
        }
        pool = stack.enter_context(ThreadPoolExecutor(workers))
        ahead: deque[tuple[Window, Future[dict[str, NDArray[Any]]]]] = deque()
        remaining = iter(windows)
        for done in range(len(windows)):
            while len(ahead) <= workers and (window := next(remaining, None)) is not None:
                ahead.append((window, pool.submit(render_layers, city, tuple(paths), window)))
            (row, column, rows, columns), tile_layers = ahead.popleft()
            for layer, block in tile_layers.result().items():
                # Bands come first in rasterio.
                files[layer].write(np.atleast_3d(block.T).T, window=RasterWindow(column, row, columns, rows))
            if progress is not None:
                progress(done + 1, len(windows))


def _windows(city: City, tile: int) -> Iterator[Window]:
    """The tiles of a city in row-major order."""
    for row in range(0, city.rows, tile):
        for column in range(0, city.columns, tile):
            yield row, column, min(tile, city.rows - row), min(tile, city.columns - column)


def _profile(city: City, layer: str, workers: int) -> dict[str, Any]:
    """How a layer's file is created."""
    common = {
        "driver": "GTiff",
        "height": city.rows,
        "width": city.columns,
        "count": 1,
        "crs": city.crs,
        "transform": city.transform,
        "tiled": True,
        "blockxsize": BLOCK,
        "blockysize": BLOCK,
        "compress": "deflate",
        "zlevel": 1,
        "num_threads": workers,
        "bigtiff": "IF_SAFER",
    }
    return common | PROFILES[layer]
