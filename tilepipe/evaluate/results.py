"""The layers of runs that can be scored, and where runs have had data, as their pipelines declare it."""

from __future__ import annotations

import os
from pathlib import Path

from tilepipe.errors import InputError
from tilepipe.io.vectors.tables import VectorLayer, is_folder, read_layer, run_table
from tilepipe.pipelines import registry


def read_result(source: str | os.PathLike[str] | VectorLayer, layer: str | None = None) -> VectorLayer:
    """Read an extracted layer: a vector file, or the layer of a run's folder that can be scored.

    ``layer`` names the layer of a file of several.

    Raises
    ------
    InputError
        See `tilepipe.io.vectors.tables.read_layer`; a folder holds no such layer.
    """
    if isinstance(source, VectorLayer) or not is_folder(Path(source)):
        return read_layer(source, "result", layer)
    if layer is not None:
        raise InputError(f"{os.fspath(source)} is a folder: leave --result-layer out, or name a file in it")
    names = [item.name for pipeline in registry.pipelines_of(Path(source)) for item in pipeline.scored]
    found = (run_table(Path(source), name) for name in names)
    table = next((path for path in found if path is not None), None)
    if table is None:
        missing = ", ".join(f"no {name}.parquet" for name in names) or "no layer that can be scored"
        raise InputError(f"{os.fspath(source)} holds {missing}; give the folder of a finished run")
    return read_layer(table, "result")


def extent_raster(folder: Path) -> Path | None:
    """Raster of a run whose nodata is that of its input; None where there is no finished run."""
    declared = (pipeline.extent for pipeline in registry.pipelines_of(folder))
    paths = (folder / layer.name for layer in declared if layer is not None)
    return next((path for path in paths if path.is_file()), None)
