"""Brute-force street graphs: pixel sets and tuples of pixels, one whole raster, no tiles."""

from __future__ import annotations

from itertools import pairwise
from math import sqrt

import numpy as np
from numpy.typing import NDArray

STEPS = [(-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1)]

Line = tuple[int, ...]


def neighbours(links: NDArray[np.uint8]) -> dict[int, set[int]]:
    """Linked neighbours of each pixel that has any, by flat index."""
    rows, columns = links.shape
    graph: dict[int, set[int]] = {}
    for row in range(rows):
        for column in range(columns):
            for k, (down, right) in enumerate(STEPS):
                if links[row, column] >> k & 1:
                    graph.setdefault(row * columns + column, set()).add((row + down) * columns + column + right)
    return graph


def links_of(pairs: set[tuple[int, int]], shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Pixel graph of the given pairs of neighbouring pixels."""
    links = np.zeros(shape, np.uint8)
    for pair in pairs:
        for one, other in (pair, pair[::-1]):
            (row, column), (r, c) = divmod(one, shape[1]), divmod(other, shape[1])
            links[row, column] |= 1 << STEPS.index((r - row, c - column))
    return links


def lines(graph: dict[int, set[int]]) -> list[Line]:
    """Chains between nodes and closed rings (first pixel repeated), in canonical direction and order."""
    found = set()
    passed = set()
    for node, linked in graph.items():
        if len(linked) == 2:
            continue
        for second in linked:
            line = [node, second]
            while len(graph[line[-1]]) == 2:
                (following,) = graph[line[-1]] - {line[-2]}
                line.append(following)
            passed.update(line)
            found.add(min(tuple(line), tuple(line[::-1])))
    for pixel in sorted(graph):
        if len(graph[pixel]) == 2 and pixel not in passed:
            ring = [pixel, min(graph[pixel])]
            while ring[-1] != pixel:
                (following,) = graph[ring[-1]] - {ring[-2]}
                ring.append(following)
            passed.update(ring)
            found.add(tuple(ring))
    return sorted(found, key=lambda line: min(tuple(sorted(link)) for link in pairwise(line)))


def length(line: Line, columns: int) -> float:
    """Length of a chain of pixels."""
    axial = diagonal = 0
    for one, other in pairwise(line):
        slanted = one // columns != other // columns and one % columns != other % columns
        axial, diagonal = axial + (not slanted), diagonal + slanted
    return axial + sqrt(2.0) * diagonal


def prune(found: list[Line], minimum: float, columns: int) -> set[Line]:
    """Prune terminal branches in rounds; rings and loops are given from their lowest rotation."""
    found = list(found)
    while True:
        ends: dict[int, list[int]] = {}
        for i, line in enumerate(found):
            ends.setdefault(line[0], []).append(i)
            ends.setdefault(line[-1], []).append(i)
        short = {}
        for i, line in enumerate(found):
            for tip, junction in ((line[0], line[-1]), (line[-1], line[0])):
                if len(ends[tip]) == 1 and len(ends[junction]) >= 3 and length(line, columns) < minimum:
                    short[i] = junction
        for junction in set(short.values()):
            if all(i in short for i in ends[junction]):
                del short[max(ends[junction], key=lambda i: (length(found[i], columns), -i))]
        if not short:
            return {lowest_form(line) for line in found}
        found = _dissolve([line for i, line in enumerate(found) if i not in short])


def lowest_form(line: Line) -> Line:
    """The lowest way to read a line, either way round, a closed one from any of its pixels."""
    ways = [line]
    if line[0] == line[-1]:
        ways = [line[i:-1] + line[: i + 1] for i in range(len(line) - 1)]
    return min(min(way, way[::-1]) for way in ways)


def _dissolve(found: list[Line]) -> list[Line]:
    while True:
        ends: dict[int, list[int]] = {}
        for i, line in enumerate(found):
            ends.setdefault(line[0], []).append(i)
            ends.setdefault(line[-1], []).append(i)
        for node, (one, *more) in ends.items():
            if len(more) == 1 and more[0] != one:
                first, second = found[one], found[more[0]]
                first = first if first[-1] == node else first[::-1]
                second = second if second[0] == node else second[::-1]
                found = [line for i, line in enumerate(found) if i not in (one, more[0])] + [first + second[1:]]
                break
        else:
            # Ties go to the line of the lowest link, in the order of the unpruned lines.
            return sorted(found, key=lambda line: min(tuple(sorted(link)) for link in pairwise(line)))
