"""Tracing chains of linked edge elements: the whole raster's table at once, in one canonical order.

Nevatia and Babu, "Linear Feature Extraction and Description", Computer Graphics and Image Processing 13, 1980,
Section 2.4 f., where they are called boundary segments.  A chain follows primary successors, so the table and not the
raster is walked: 8 to 23 bytes an element beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import loop
from tilepipe_kernels.core.polylines import Polylines
from tilepipe_kernels.core.ragged import reduce_runs
from tilepipe_kernels.network.tracing import COLUMN_STEP, ROW_STEP
from tilepipe_kernels.nevatia_babu.links import (
    NO_LINK,
    PREDECESSOR,
    SECOND_SUCCESSOR,
    SUCCESSOR,
    EdgeElements,
    Int64,
    Links,
)

Members = NDArray[Any]


@dataclass(frozen=True)
class ElementChains:
    """Traced chains in the order of tracing, as flat arrays.

    Attributes
    ----------
    offsets
        int64, shape (n + 1,): chain i has ``members[offsets[i]:offsets[i + 1]]``, at least two.
    members
        int32 or int64, shape (m,): indices into the table of elements, bright side on the left of their order. A
        branch starts at the element that forks; a chain that runs into a traced one ends there; a ring repeats its
        first element.
    stage
        uint8, shape (n,): 1 … 3, the stage that traced it.
    """

    offsets: Int64
    members: Members
    stage: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.stage)

    def polylines(self, elements: EdgeElements) -> Polylines:
        """The chains through the pixels (row, column) of their elements, int32."""
        pixels = np.stack(np.divmod(elements.pixel[self.members], elements.width), axis=1).astype(np.int32)
        return Polylines(self.offsets, pixels)

    def mean_magnitudes(self, elements: EdgeElements) -> NDArray[np.float64]:
        """Mean magnitude of each chain's elements, float64, shape (n,)."""
        sums = reduce_runs(np.add, elements.magnitude[self.members], self.offsets, dtype=np.float64)
        return np.asarray(sums / np.diff(self.offsets))


@loop
def _find_successors(pixel: Int64, links: Links, steps: Int64, primary: Members, secondary: Members) -> int:
    """Index of the successors of each element, -1 for none; returns the first element whose link leads nowhere."""
    # The targets in one direction ascend with the elements: one cursor a direction passes the table once.
    cursors = np.zeros(8, np.int64)
    for i in range(pixel.size):
        for second in (False, True):
            k = links[i, SECOND_SUCCESSOR if second else SUCCESSOR]
            at = np.int64(-1)
            if k != NO_LINK:
                target, at = pixel[i] + steps[k], cursors[k]
                while at < pixel.size and pixel[at] < target:
                    at += 1
                cursors[k] = at
                if at == pixel.size or pixel[at] != target:
                    return i
            if second:
                secondary[i] = at
            else:
                primary[i] = at
    return -1


@loop
def _walk(start: int, primary: Members, traced: NDArray[np.bool_], members: Members, cursor: int) -> int:
    """Append a chain of primary successors, up to and with the first traced element, or to the end."""
    at = start
    while at >= 0:
        members[cursor] = at
        cursor += 1
        if traced[at]:
            break
        traced[at] = True
        at = primary[at]
    return cursor


@loop
def _chains_left(primary: Members, traced: NDArray[np.bool_]) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Of the elements not traced: how many of them lead to each, and which form rings of primary successors."""
    entries = np.zeros(traced.size, np.uint8)
    for i in range(traced.size):
        if not traced[i] and primary[i] >= 0:
            entries[primary[i]] += 1
    left, ring = entries.copy(), ~traced
    for i in range(traced.size):
        at = i
        # What nothing leads to is no part of a ring; nor is then what it alone leads to.
        while at >= 0 and ring[at] and left[at] == 0:
            ring[at] = False
            at = primary[at]
            if at >= 0:
                left[at] -= 1
    return entries, ring


@loop
def _close(offsets: Int64, stage: NDArray[np.uint8], count: int, cursor: int, number: int) -> tuple[int, int]:
    """End a chain at the cursor; a lone element is none."""
    if cursor - offsets[count] < 2:
        return count, offsets[count]
    stage[count] = number
    offsets[count + 1] = cursor
    return count + 1, cursor


@loop
def _trace_branches(
    primary: Members, secondary: Members, traced: NDArray[np.bool_],
    members: Members, offsets: Int64, stage: NDArray[np.uint8], begin: int, count: int, number: int,
) -> int:  # fmt: skip
    """Trace from the untraced secondary successors of the members from ``begin`` on, and of the branches' own."""
    at, cursor = begin, offsets[count]
    while at < cursor:
        fork = members[at]
        branch = secondary[fork]
        at += 1
        if branch >= 0 and not traced[branch]:
            members[cursor] = fork
            count, cursor = _close(offsets, stage, count, _walk(branch, primary, traced, members, cursor + 1), number)
    return count


@loop
def _trace(
    links: Links, primary: Members, secondary: Members, members: Members, offsets: Int64, stage: NDArray[np.uint8]
) -> int:
    n = primary.size
    traced = np.zeros(n, np.bool_)
    count = 0
    cursor = 0
    for i in range(n):
        if links[i, PREDECESSOR] == NO_LINK and not traced[i]:
            count, cursor = _close(offsets, stage, count, _walk(i, primary, traced, members, cursor), 1)
    count = _trace_branches(primary, secondary, traced, members, offsets, stage, 0, count, 2)
    entries, ring = _chains_left(primary, traced)
    begin = cursor = int(offsets[count])
    for rings in (True, False):
        for i in range(n):
            if not traced[i] and (ring[i] if rings else entries[i] == 0):
                count, cursor = _close(offsets, stage, count, _walk(i, primary, traced, members, cursor), 3)
        count = _trace_branches(primary, secondary, traced, members, offsets, stage, begin, count, 3)
        begin = cursor = int(offsets[count])
    return count


def trace_chains(elements: EdgeElements) -> ElementChains:
    """Trace chains through the elements of a whole raster (Nevatia & Babu 1980).

    1. Chains that start at elements without predecessor, in row-major order, and follow the primary successors,
       until there is none or it is traced already.
    2. Branches, which start at secondary successors that are not traced, of all elements traced so far.
    3. Whatever is left: rings first, each from its first element in row-major order, then chains from the elements
       that none of the rest leads to; the branches of both after them.

    Lone elements form no chain.

    Parameters
    ----------
    elements
        Of the whole raster, from `join_elements`.

    Returns
    -------
    ElementChains
        In the order of tracing: the same for any tiling.

    Raises
    ------
    ValueError
        If a link leads to a pixel that holds no element.

    Examples
    --------
    The two sides of a bright stripe are two chains, each with the stripe on its left: one runs down, the other up.

    >>> import numpy as np
    >>> from tilepipe_kernels.nevatia_babu.links import find_elements
    >>> from tilepipe_kernels.nevatia_babu.tracing import trace_chains
    >>> elements = find_elements(np.tile(np.repeat([50, 200, 50], 8), (12, 1)), threshold=20_000)
    >>> trace_chains(elements).polylines(elements).ends.tolist()  # (row, column), first and last
    [[2, 7], [9, 7], [9, 15], [2, 15]]
    """
    n = len(elements)
    index_type = np.int32 if n < 2**31 else np.int64
    primary, secondary = np.empty(n, index_type), np.empty(n, index_type)
    steps = ROW_STEP * elements.width + COLUMN_STEP
    lost = _find_successors(elements.pixel, elements.links, steps, primary, secondary)
    if lost >= 0:
        row, column = divmod(int(elements.pixel[lost]), elements.width)
        raise ValueError(f"a link of pixel ({row}, {column}) leads to no edge element: join the tables of all tiles")
    # A chain repeats at most two elements, those where it begins and ends; what is not used stays unmapped.
    members, offsets, stage = np.empty(3 * n + 2, index_type), np.zeros(n + 2, np.int64), np.empty(n + 1, np.uint8)
    count = _trace(elements.links, primary, secondary, members, offsets, stage)
    return ElementChains(offsets[: count + 1].copy(), members[: offsets[count]].copy(), stage[:count].copy())
