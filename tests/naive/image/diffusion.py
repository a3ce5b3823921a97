"""Nonlinear diffusion pixel by pixel in float64, written from the equations and the stated nodata rule."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float64]


def neighbour(image: Image, i: int, j: int, di: int, dj: int) -> float:
    """Value at (i + di, j + dj); the value at (i, j) where that is missing or outside."""
    rows, columns = image.shape
    if 0 <= i + di < rows and 0 <= j + dj < columns and not math.isnan(image[i + di, j + dj]):
        return float(image[i + di, j + dj])
    return float(image[i, j])


def gaussian(image: Image, sigma: float) -> Image:
    radius = math.ceil(3 * sigma)
    if radius == 0:
        return image.copy()
    offsets = range(-radius, radius + 1)
    weights = {k: math.exp(-k * k / (2 * sigma * sigma)) for k in offsets}
    total = sum(weights.values())
    for di, dj in ((1, 0), (0, 1)):
        result = np.full_like(image, np.nan)
        for i, j in np.ndindex(image.shape):
            result[i, j] = sum(weights[k] * neighbour(image, i, j, k * di, k * dj) for k in offsets) / total
        image = result
    return image


def curvature_step(u: Image, given: Image, time_step: float, k: float, sigma: float, fidelity: float) -> Image:
    smooth, result = gaussian(u, sigma), u.copy()
    for i, j in np.ndindex(u.shape):
        if math.isnan(u[i, j]):
            continue
        near = {(di, dj): neighbour(u, i, j, di, dj) for di in (-1, 0, 1) for dj in (-1, 0, 1)}
        c = near[0, 0]
        ux, uy = (near[0, 1] - near[0, -1]) / 2, (near[1, 0] - near[-1, 0]) / 2
        uxx, uyy = near[0, 1] + near[0, -1] - 2 * c, near[1, 0] + near[-1, 0] - 2 * c
        uxy = (near[1, 1] + near[-1, -1] - near[-1, 1] - near[1, -1]) / 4
        flat = 1e-6
        motion = uxx * (uy * uy + flat) - 2 * ux * uy * uxy + uyy * (ux * ux + flat)
        motion /= ux * ux + uy * uy + 2 * flat
        gx = (neighbour(smooth, i, j, 0, 1) - neighbour(smooth, i, j, 0, -1)) / 2
        gy = (neighbour(smooth, i, j, 1, 0) - neighbour(smooth, i, j, -1, 0)) / 2
        g = 1 / (1 + k * (gx * gx + gy * gy))
        moved = c + time_step * (g * motion - fidelity * (1 - g) * (c - given[i, j]))
        allowed: list[float] = [*near.values(), float(given[i, j])]
        result[i, j] = np.clip(moved, min(allowed), max(allowed))
    return result


def perona_malik_step(u: Image, time_step: float, threshold: float, model: str) -> Image:
    result = u.copy()
    for i, j in np.ndindex(u.shape):
        if math.isnan(u[i, j]):
            continue
        for di, dj in ((-1, 0), (1, 0), (0, -1), (0, 1)):
            d = neighbour(u, i, j, di, dj) - float(u[i, j])
            squared = (d / threshold) ** 2
            c = math.exp(-squared) if model == "perona-malik-exponential" else 1 / (1 + squared)
            result[i, j] += time_step * c * d
    return result


def diffuse(
    image: Image, steps: int, time_step: float, conductance: float, sigma: float, fidelity: float, model: str
) -> Image:
    given = np.asarray(image, np.float64)
    u = given.copy()
    for _ in range(steps):
        if model == "curvature":
            u = curvature_step(u, given, time_step, conductance, sigma, fidelity)
        else:
            u = perona_malik_step(u, time_step, conductance, model)
    return u
