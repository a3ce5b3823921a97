"""How many points a cloud holds, whatever its header counts."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import laspy
import lazrs

_LAYERED = 6
"""Point format since which compressed chunks say how many points they have (LASzip 3)."""


def held_points(path: Path) -> tuple[int, int] | None:
    """Fewest and most points that lie in a file; None where its table of chunks does not tell.

    Points of LAS lie between their offset and the next thing in the file.  Those of LAZ lie in chunks: of as many
    points as the table says, or of a fixed number, of which the last one may have fewer.

    Parameters
    ----------
    path
        A LAS, LAZ or COPC file.

    Examples
    --------
    >>> from pathlib import Path
    >>> import laspy
    >>> import numpy as np
    >>> from tilepipe.io.clouds.counts import held_points
    >>> cloud = laspy.create()
    >>> cloud.x, cloud.y, cloud.z = np.array([[10.0, 12.5], [20.0, 21.0], [3.0, 4.0]])
    >>> cloud.write("cloud.las")
    >>> held_points(Path("cloud.las"))
    (2, 2)
    """
    with path.open("rb") as file:
        header = laspy.LasHeader.read_from(file)
        if header.are_points_compressed:
            return _in_chunks(file, header)
    first, behind = header.offset_to_point_data, [header.start_of_waveform_data_packet_record]
    if header.number_of_evlrs:
        behind.append(header.start_of_first_evlr)
    # a place before the points, such as 0, names nothing
    end = min([path.stat().st_size, *(place for place in behind if place >= first)])
    room = max(0, end - first) // header.point_format.size
    return room, room


def _in_chunks(file: BinaryIO, header: laspy.LasHeader) -> tuple[int, int] | None:
    file.seek(header.offset_to_point_data)
    try:
        described = lazrs.LazVlr(header.vlrs.get("LasZipVlr")[0].record_data)
        table = lazrs.read_chunk_table(file, described)
    except (lazrs.LazrsError, OSError, IndexError):
        return None
    if not table:
        return 0, 0
    if described.uses_variable_size_chunks():
        total = sum(points for points, _ in table)
        return total, total
    whole = (len(table) - 1) * described.chunk_size()
    if header.point_format.id < _LAYERED:
        return whole + 1, whole + described.chunk_size()
    # the first point stands as it is, and the number of points behind it
    file.seek(sum(size for _, size in table[:-1]) + described.item_size(), 1)
    last = int.from_bytes(file.read(4), "little")
    return whole + last, whole + last
