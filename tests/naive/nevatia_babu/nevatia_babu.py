"""Nevatia & Babu by brute force: one whole raster, plain loops, dicts and sets of (row, column)."""

from __future__ import annotations

from math import atan2, cos, degrees, radians, sin

import numpy as np

from tilepipe_kernels.nevatia_babu.masks import MASKS

Pixel = tuple[int, int]
Edges = dict[Pixel, tuple[float, int | None]]
Links = dict[Pixel, tuple[list[Pixel], list[Pixel]]]


def responses(image: np.ndarray) -> Edges:
    """Magnitude and direction of the pixels whose 25 neighbours are known; direction None without response."""
    found: Edges = {}
    for row in range(2, image.shape[0] - 2):
        for column in range(2, image.shape[1] - 2):
            window = image[row - 2 : row + 3, column - 2 : column + 3].astype(float)
            if np.isfinite(window).all():
                answers = [float((mask * window).sum()) for mask in MASKS]
                k = max(range(6), key=lambda index: (abs(answers[index]), -index))
                direction = None if answers[k] == 0 else k + 6 * (answers[k] < 0)
                found[row, column] = abs(answers[k]), direction
    return found


def step(angle: float) -> Pixel:
    """Neighbour in the direction of an angle (degrees, counterclockwise from right), diagonal for 30° and 60°."""
    right, up = cos(radians(angle)), sin(radians(angle))
    return -int(round(up * 1.2)), int(round(right * 1.2))


def across(pixel: Pixel, direction: int) -> list[Pixel]:
    down, right = step(30 * direction)
    return sorted([(pixel[0] + down, pixel[1] + right), (pixel[0] - down, pixel[1] - right)])


def apart(one: int, other: int) -> int:
    return min((one - other) % 12, (other - one) % 12)


def beats(edges: Edges, one: Pixel, other: Pixel) -> bool:
    return (-edges[one][0], one) < (-edges[other][0], other)


def thin(edges: Edges, threshold: float) -> dict[Pixel, tuple[float, int]]:
    winners: dict[Pixel, list[Pixel]] = {}
    for pixel, (_, direction) in edges.items():
        if direction is None:
            continue
        rivals = across(pixel, direction)
        if all(rival in edges and beats(edges, pixel, rival) for rival in rivals):
            others = [edges[rival][1] for rival in rivals]
            if all(other is None or apart(other, direction) <= 1 for other in others):
                winners[pixel] = rivals
    losers = {rival for rivals in winners.values() for rival in rivals}
    return {p: edges[p] for p in sorted(winners) if p not in losers and edges[p][0] > threshold}  # type: ignore[misc]


def continuations(elements: dict[Pixel, tuple[float, int]], pixel: Pixel, heading: float) -> list[Pixel]:
    """Primary and secondary continuation, as far as there are any."""
    direction = elements[pixel][1]
    down, right = step(heading)
    middle = degrees(atan2(-down, right))
    found = {}
    for place in (-1, 0, 1):
        angle = middle + 45 * place
        other = pixel[0] + step(angle)[0], pixel[1] + step(angle)[1]
        if other in elements and apart(elements[other][1], direction) <= 1:
            turn = abs((angle - heading + 180) % 360 - 180)
            length = abs(step(angle)[0]) + abs(step(angle)[1])
            strength = np.float32(elements[other][0])
            found[place] = (apart(elements[other][1], direction), length, round(turn), -strength, other)
    ordered = [rank[-1] for rank in sorted(found.values())]
    if len(found) == 3:
        kinds = [elements[other][1] for other in ordered]
        if len(set(kinds)) == 2:
            (odd,) = (other for other, kind in zip(ordered, kinds, strict=True) if kinds.count(kind) == 1)
            ordered = [next(other for other in ordered if other != odd), odd]
        return ordered[:2]
    return ordered if set(found) == {-1, 1} else ordered[:1]


def link(elements: dict[Pixel, tuple[float, int]]) -> Links:
    """Predecessors and successors; an edge runs at right angles to its direction, bright side left."""
    return {
        pixel: (
            continuations(elements, pixel, 30 * direction + 90),
            continuations(elements, pixel, 30 * direction - 90),
        )
        for pixel, (_, direction) in elements.items()
    }


def trace(links: Links) -> list[tuple[int, list[Pixel]]]:
    """Stage and pixels of every segment of at least two pixels."""
    traced: set[Pixel] = set()
    segments: list[tuple[int, list[Pixel]]] = []

    def walk(stage: int, start: Pixel, before: list[Pixel]) -> None:
        segment = [*before, start]
        while segment[-1] not in traced:
            traced.add(segment[-1])
            following = links[segment[-1]][1]
            if not following:
                break
            segment.append(following[0])
        if len(segment) > 1:
            segments.append((stage, segment))

    def branches(stage: int, begin: int) -> None:
        while begin < len(segments):
            for pixel in segments[begin][1]:
                following = links[pixel][1]
                if len(following) == 2 and following[1] not in traced:
                    walk(stage, following[1], [pixel])
            begin += 1

    pixels = sorted(links)
    for pixel in pixels:
        if not links[pixel][0] and pixel not in traced:
            walk(1, pixel, [])
    branches(2, 0)
    begin = len(segments)
    for pixel in pixels:
        ahead = [pixel]
        while ahead[-1] not in traced and links[ahead[-1]][1] and len(ahead) <= len(pixels):
            ahead.append(links[ahead[-1]][1][0])
            if ahead[-1] == pixel:
                walk(3, pixel, [])
                break
    branches(3, begin)
    begin = len(segments)
    led_to = {following[0] for pixel, (_, following) in links.items() if following and pixel not in traced}
    for pixel in pixels:
        if pixel not in traced and pixel not in led_to:
            walk(3, pixel, [])
    branches(3, begin)
    assert traced == set(links)
    return segments
