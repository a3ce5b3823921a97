"""Points of clouds, read in chunks as integers, and those of them that count."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import laspy
import numpy as np
from laspy import DecompressionSelection, LazBackend
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.clouds import Cloud

Value = Literal["height", "intensity"]
Returns = Literal["first", "last", "all"]

NOISE_CLASSES = (7, 18)
"""ASPRS classes low and high noise, left out unless asked for."""

_FIELDS = (
    DecompressionSelection.XY_RETURNS_CHANNEL
    | DecompressionSelection.Z
    | DecompressionSelection.CLASSIFICATION
    | DecompressionSelection.FLAGS
    | DecompressionSelection.INTENSITY
)

Chunk = tuple[int, NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]
"""Points read, and of those that count x, y and value; see `read_points`."""


@dataclass(frozen=True)
class PointFilter:
    """Which points count: withheld points never; ``classes`` None means all but noise (7 and 18)."""

    classes: tuple[int, ...] | None = None
    returns: Returns = "all"

    def keep(self, chunk: Any) -> NDArray[np.bool_]:
        """True for each point of a chunk that counts."""
        classes = np.asarray(chunk.classification)
        kept = ~np.isin(classes, NOISE_CLASSES) if self.classes is None else np.isin(classes, self.classes)
        kept &= np.asarray(chunk.withheld) == 0
        # Writers that know no returns leave zeros: such points are both first and last.
        if self.returns == "first":
            kept &= np.asarray(chunk.return_number) <= 1
        elif self.returns == "last":
            kept &= np.asarray(chunk.return_number) >= np.asarray(chunk.number_of_returns)
        return kept


def value_quantum(clouds: Sequence[Cloud], value: Value) -> float:
    """Size of a value's tick: 1 for intensity, for heights the finest z scale (coarser if int32 needs it)."""
    if value == "intensity":
        return 1.0
    quantum = min(cloud.scales[2] for cloud in clouds)
    extreme = max(
        abs(raw * cloud.scales[2] + cloud.offsets[2]) for cloud in clouds for raw in (cloud.lowest[2], cloud.highest[2])
    )
    while extreme / quantum >= 2**31 - 1:
        quantum *= 10
    return quantum


def read_points(
    cloud: Cloud, value: Value, quantum: float, point_filter: PointFilter, chunk_points: int, parallel: bool
) -> Iterator[Chunk]:
    """Read a cloud in chunks.

    Yields
    ------
    count, x, y, values
        Number of points read; of those that pass the filter the LAS integer coordinates and the values in
        ticks of ``quantum``, all int32.

    Raises
    ------
    InputError
        Naming the file, if it is cut off or damaged, or has points outside the bounding box of its header.
    """
    backend = LazBackend.LazrsParallel if parallel else LazBackend.Lazrs
    left = cloud.points
    try:
        with laspy.open(cloud.path, laz_backend=backend, decompression_selection=_FIELDS) as reader:
            while left > 0:
                wanted = min(chunk_points, left)
                chunk = reader.read_points(wanted)
                if len(chunk) < wanted:
                    raise InputError(f"{cloud.path}: cut off {left - len(chunk):,} points before its end")
                left -= wanted
                yield wanted, *_columns(cloud, chunk, value, quantum, point_filter)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{cloud.path}: damaged or cut off ({error}); get a fresh copy") from error


def _columns(
    cloud: Cloud, chunk: Any, value: Value, quantum: float, point_filter: PointFilter
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    x, y = np.array(chunk.X, np.int32), np.array(chunk.Y, np.int32)
    for axis, raw in enumerate((x, y, np.asarray(chunk.Z))):
        if int(raw.min()) < cloud.lowest[axis] or int(raw.max()) > cloud.highest[axis]:
            raise InputError(
                f"{cloud.path}: points lie outside the bounding box of the header; repair it (lasinfo -repair_bb)"
            )
    if value == "intensity":
        values = np.array(chunk.intensity, np.int32)
    else:
        heights = np.asarray(chunk.Z) * cloud.scales[2] + cloud.offsets[2]
        values = np.rint(heights / quantum).astype(np.int32)
    keep = point_filter.keep(chunk)
    if keep.all():
        return x, y, values
    return x[keep], y[keep], values[keep]
