"""The kernels that a run of `edges` calls last, called once on a drawn scene, so that they lie compiled on disk."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from tilepipe.engine.parameters import checked_parameters
from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.io.rasters.georeference import Geometry
from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe.pipelines.edges.pass_fields import ELEMENT_COLUMNS, FRAGMENT_COLUMNS
from tilepipe.pipelines.edges.tables import write_edges, write_nevatia_babu
from tilepipe_kernels.nevatia_babu.links import find_elements
from tilepipe_kernels.polylines.crack_lines import trace_crack_lines

_SIDE = 64


def warm_up() -> None:
    """Trace the outlines of a square and its classical edges, and write both tables."""
    inside = np.zeros((_SIDE, _SIDE), np.uint8)
    inside[20:44, 16:40] = 1
    grey = np.where(inside > 0, 180, 60).astype(np.float32)
    below, right = (np.abs(np.diff(inside.astype(np.int8), axis=axis, append=0)).astype(np.uint8) for axis in (0, 1))
    core = (2, 2, _SIDE - 2, _SIDE - 2)
    lines = trace_crack_lines(below, right, grey, core, (0, 0))
    elements = find_elements(grey, 20.0, core, (0, 0), _SIDE)
    facts = {name: getattr(lines, name) for name in FRAGMENT_COLUMNS}
    facts |= {f"element:{name}": getattr(elements, name) for name in ELEMENT_COLUMNS}
    geometry = Geometry("EPSG:32633", 5e5, 5e6, 0.5, (_SIDE, _SIDE), 1.0, 1.0)
    parameters = checked_parameters(EdgeParameters, {})
    with tempfile.TemporaryDirectory() as folder:
        ledger = Ledger(Path(folder) / "fields")
        ledger.record("r0000c0000", facts)
        write_edges(Path(folder) / "edges.parquet", ledger, geometry, parameters, 2)
        write_nevatia_babu(Path(folder) / "nevatia_babu.parquet", ledger, geometry, parameters)
