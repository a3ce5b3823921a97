"""Brute-force oracles for the line detector: direct sums in float64 and loops over dictionaries."""

from __future__ import annotations

import math

import numpy as np

OFFSETS = ((-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1))


def gaussian_derivatives(block, sigma):
    """Direct two-dimensional correlation of the border-replicated block with normalised kernels."""
    radius = math.ceil(4 * sigma)
    k = np.arange(-radius, radius + 1.0)
    g = np.exp(-(k**2) / (2 * sigma**2))
    g /= g.sum()
    variance = (k**2 * g).sum()
    g_1 = k * g / variance
    g_2 = (k**2 - variance) * g
    g_2 /= (k**2 * g_2).sum() / 2
    padded = np.pad(np.asarray(block, np.float64), radius, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (k.size, k.size))
    return tuple(
        np.einsum("rcij,i,j->rc", windows, down, along, optimize=True)
        for along, down in ((g_1, g), (g, g_1), (g_2, g), (g_1, g_1), (g, g_2))
    )


def line_points(block, sigma, low, dark, reach=0.6):
    """{(row, col): (dx, dy, nx, ny, response)} by numpy's eigenvectors."""
    sign = 1 if dark else -1
    r_x, r_y, r_xx, r_xy, r_yy = (sign * image for image in gaussian_derivatives(block, sigma))
    points = {}
    for row, col in np.ndindex(r_x.shape):
        hessian = np.array([[r_xx[row, col], r_xy[row, col]], [r_xy[row, col], r_yy[row, col]]])
        values, vectors = np.linalg.eigh(hessian)
        largest = int(np.argmax(np.abs(values)))
        n_x, n_y = vectors[:, largest]
        if n_x < 0:
            n_x, n_y = -n_x, -n_y
        t = -(r_x[row, col] * n_x + r_y[row, col] * n_y) / values[largest]
        if values[largest] >= low and abs(t * n_x) <= reach and abs(t * n_y) <= reach:
            points[row, col] = (t * n_x, t * n_y, n_x, n_y, values[largest])
    return points


def is_symmetric(points, links):
    """Whether every link is set at both of its ends, and ends on a point."""
    at = {(int(r), int(c)): int(bits) for r, c, bits in zip(points.row, points.col, links, strict=True)}
    for (row, col), bits in at.items():
        for k, (down, right) in enumerate(OFFSETS):
            if bits >> k & 1 and not at.get((row + down, col + right), 0) >> (k + 4) % 8 & 1:
                return False
    return True


def graph(points, links):
    """Adjacency sets of the linked points, by index."""
    index = {(int(r), int(c)): i for i, (r, c) in enumerate(zip(points.row, points.col, strict=True))}
    return {
        i: {index[row + down, col + right] for k, (down, right) in enumerate(OFFSETS) if int(links[i]) >> k & 1}
        for (row, col), i in index.items()
    }


def has_loop_of_three_or_four(adjacency):
    for nearby in adjacency.values():
        for j in nearby:
            if nearby & adjacency[j]:
                return True
        for j in nearby:
            for k in nearby:
                if j < k and len(adjacency[j] & adjacency[k]) > 1:
                    return True
    return False


def components(adjacency):
    """Sizes of the connected components of linked points, largest first."""
    seen, sizes = set(), []
    for start in adjacency:
        if start in seen or not adjacency[start]:
            continue
        stack, size = [start], 0
        seen.add(start)
        while stack:
            i = stack.pop()
            size += 1
            for j in adjacency[i] - seen:
                seen.add(j)
                stack.append(j)
        sizes.append(size)
    return sorted(sizes, reverse=True)


def bar(shape, angle, offset, half_width, contrast=-100.0, asymmetry=0.0, level=200.0):
    """Antialiased straight bar near the centre, and each pixel's signed distance across it."""
    row, col = np.mgrid[: shape[0], : shape[1]].astype(float)
    across = (col - shape[1] / 2) * math.cos(angle) + (row - shape[0] / 2) * math.sin(angle) - offset
    left = np.clip(across + half_width + 0.5, 0, 1)
    right = np.clip(across - half_width + 0.5, 0, 1)
    return level + contrast * (left - (1 - asymmetry) * right), across
