"""Points of clouds, read in chunks, and those of them that count."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import laspy
import numpy as np
from laspy import DecompressionSelection, LazBackend
from numpy.typing import NDArray

from tilepipe.errors import InputError
from tilepipe.io.clouds.cloud import Cloud
from tilepipe.io.files.identity import ChangedInputError
from tilepipe_kernels.points.duplicates import fingerprints

Value = Literal["height", "intensity"]
Returns = Literal["first", "last", "all"]

NOISE_CLASSES = (7, 18)
"""ASPRS classes low and high noise, left out unless asked for."""

PLACES = (
    DecompressionSelection.XY_RETURNS_CHANNEL
    | DecompressionSelection.Z
    | DecompressionSelection.CLASSIFICATION
    | DecompressionSelection.FLAGS
)
"""What tells where the points that count lie."""

VALUES = PLACES | DecompressionSelection.INTENSITY
"""What tells their values as well."""

IDENTITY = VALUES | DecompressionSelection.GPS_TIME
"""What tells a point from all others as well."""

Chunk = tuple[int, Any]
"""Number of points read, and laspy's records of those that count."""


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


def read_points(
    cloud: Cloud, fields: DecompressionSelection, point_filter: PointFilter, chunk_points: int, parallel: bool
) -> Iterator[Chunk]:
    """Read a cloud in chunks.

    Yields
    ------
    count, points
        Number of points read; laspy's records of those that pass the filter, of which only ``fields`` are sure
        to be filled.

    Raises
    ------
    InputError
        Naming the file, if it is cut off or damaged, or has changed since its header was read.
    """
    backend = LazBackend.LazrsParallel if parallel else LazBackend.Lazrs
    left = cloud.points
    try:
        with laspy.open(cloud.path, laz_backend=backend, decompression_selection=fields) as reader:
            while left > 0:
                wanted = min(chunk_points, left)
                chunk = reader.read_points(wanted)
                if len(chunk) < wanted:
                    raise InputError(f"{cloud.path}: cut off {left - len(chunk):,} points before its end")
                left -= wanted
                keep = point_filter.keep(chunk)
                yield wanted, chunk if keep.all() else chunk[keep]
        _check_unchanged(cloud)
    except InputError:
        _check_unchanged(cloud)
        raise
    except Exception as error:
        _check_unchanged(cloud)
        raise InputError(f"{cloud.path}: damaged or cut off ({error}); get a fresh copy") from error


def _check_unchanged(cloud: Cloud) -> None:
    """Of a file that is being replaced, what it seems to hold tells nothing."""
    try:
        cloud.files.check()
    except ChangedInputError as error:
        raise InputError(
            f"{cloud.path}: has changed since its header was read; run again when nothing writes to it any more"
        ) from error


def raw_coordinates(points: Any) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """LAS integers x and y of points."""
    return np.array(points.X, np.int32), np.array(points.Y, np.int32)


def ticks(cloud: Cloud, points: Any, value: Value, quantum: float) -> NDArray[np.int32]:
    """Values of points in ticks of ``quantum``."""
    if value == "intensity":
        return np.array(points.intensity, np.int32)
    heights = np.asarray(points.Z) * cloud.scales[2] + cloud.offsets[2]
    return np.rint(heights / quantum).astype(np.int32)


def identities(cloud: Cloud, points: Any, clouds: Sequence[Cloud]) -> NDArray[np.uint64]:
    """Fingerprints of points by place, return, intensity and GPS time, which their copies in other clouds share.

    The place counts in the coarsest steps of all ``clouds``, the time only where all of them have times: a copy may lie
    in a cloud of a format without.
    """
    scales, first = np.array([each.scales for each in clouds]), clouds[0]
    place = []
    for axis, raw in enumerate((points.X, points.Y, points.Z)):
        finest, coarsest = scales[:, axis].min(), scales[:, axis].max()
        # whole numbers of the finest steps first: what lies between two coarse ones then falls to one side
        shift = cloud.offsets[axis] - first.offsets[axis]
        steps = np.rint((np.asarray(raw) * cloud.scales[axis] + shift) / finest)
        place.append(np.rint(steps * finest / coarsest).astype(np.int64))
    fields = [*place, np.asarray(points.return_number), np.asarray(points.intensity)]
    if all(each.has_times for each in clouds):
        # of the two zeros only one is left
        fields.append(np.asarray(points.gps_time, np.float64) + 0.0)
    return fingerprints(*fields)
