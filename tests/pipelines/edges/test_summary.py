"""What `edges` says of a run: tables without lines, and how long its optimiser went on."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import geopandas
import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from tilepipe import RunOptions, edges

SIDE = 40


@pytest.fixture(scope="module")
def photograph(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dark square on bright ground."""
    grey = np.full((SIDE, SIDE), 180.0)
    grey[10:30, 10:30] = 60
    grey += np.random.default_rng(0).normal(0, 4, grey.shape)
    path = tmp_path_factory.mktemp("scene") / "photo.tif"
    profile = {"driver": "GTiff", "count": 1, "height": SIDE, "width": SIDE, "dtype": "uint8", "crs": "EPSG:32633"}
    with rasterio.open(path, "w", transform=from_origin(1000, 2000, 1, 1), **profile) as file:
        file.write(grey.astype(np.uint8), 1)
    return path


def told(photograph: Path, out: Path, **params: Any) -> list[str]:
    """Warnings of a run."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        edges(photograph, out=out, params={"levels": 2, **params}, options=RunOptions(tile=64, workers=1))
    return [str(warning.message) for warning in caught]


@pytest.mark.parametrize(
    ("params", "expected"),
    [
        ({}, []),
        ({"minimum_length": 1000.0}, ["edges has no line; lower minimum_length or raise levels"]),
        (
            {"minimum_edge_length": 1000.0},
            ["nevatia_babu has no line; raise edge_share or lower minimum_edge_length"],
        ),
        ({"minimum_length": 1000.0, "nevatia_babu": False}, ["edges has no line"]),
    ],
)
def test_a_table_without_lines_is_told(
    photograph: Path, tmp_path: Path, params: dict[str, Any], expected: list[str]
) -> None:
    found = [text for text in told(photograph, tmp_path / "run", **params) if "no line" in text]
    assert len(found) == len(expected)
    assert all(text.startswith(start) for text, start in zip(found, expected, strict=True))
    for name in ("edges", "nevatia_babu"):
        table = tmp_path / "run" / f"{name}.parquet"
        assert (table.is_file() and geopandas.read_parquet(table).empty) == any(text.startswith(name) for text in found)


def test_the_summary_names_the_sweeps_of_annealing(photograph: Path, tmp_path: Path) -> None:
    told(photograph, tmp_path / "parallel")
    told(photograph, tmp_path / "annealing", optimiser="annealing", sweeps=3)
    parallel, annealing = (
        json.loads((tmp_path / name / "edges.json").read_text()) for name in ("parallel", "annealing")
    )
    assert "sweeps" not in parallel and parallel["most_rounds"] == 24
    assert (annealing["sweeps"], annealing["most_rounds"]) == (3, 24)
