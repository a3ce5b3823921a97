"""Highest confidence first and iterated conditional modes by the total energy, in plain Python."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.naive.mrf.edge_model import energy
from tilepipe_kernels.mrf.edge_model import EdgeModel
from tilepipe_kernels.mrf.hcf import site_rank

Site = tuple[int, int, int]  # field (0: label, 1: h, 2: v), row, column


class State(NamedTuple):
    """Observed grey values and the three fields, uint8 with 255 where uncommitted."""

    y: NDArray[np.float32]
    fields: list[NDArray[np.uint8]]


def sites(state: State, integrated: bool) -> list[Site]:
    data = ~np.isnan(state.y)
    rows, columns = data.shape
    found = [(0, i, j) for i in range(rows) for j in range(columns) if data[i, j] and integrated]
    found += [(1, i, j) for i in range(rows - 1) for j in range(columns) if data[i, j] and data[i + 1, j]]
    return found + [(2, i, j) for i in range(rows) for j in range(columns - 1) if data[i, j] and data[i, j + 1]]


def energies(state: State, site: Site, model: EdgeModel) -> list[float]:
    """Total energy with each value of a site, all others as they are."""
    field, i, j = site
    array = state.fields[field]
    before = array[i, j]
    found = []
    for value in range(model.levels if field == 0 else 2):
        array[i, j] = value
        found.append(energy(state.y, *state.fields, model))
    array[i, j] = before
    return found


def between_equals(state: State, site: Site) -> bool:
    field, i, j = site
    x = state.fields[0]
    return x[i, j] != 255 and x[i, j] == (x[i + 1, j] if field == 1 else x[i, j + 1])


def waits(state: State, site: Site) -> bool:
    """Whether a label of an element is not committed."""
    field, i, j = site
    x = state.fields[0]
    return field > 0 and 255 in (x[i, j], x[i + 1, j] if field == 1 else x[i, j + 1])


def stability(state: State, site: Site, model: EdgeModel, sure: bool) -> tuple[float, int]:
    """G and the value wanted; infinite if none."""
    field, i, j = site
    if waits(state, site):
        return np.inf, 0
    u = np.array(energies(state, site, model))
    now = state.fields[field][i, j]
    best = int(np.argmax(u <= u.min() + 1e-6))
    if now == 255:
        if sure and field > 0 and u[1] >= u[0] - 1e-6 and between_equals(state, site):
            return -np.inf, 0
        return u[best] - np.delete(u, best).min(), best
    gain = u[best] - u[now]
    return (gain, best) if gain < -1e-4 else (np.inf, best)


def rank(site: Site, origin: tuple[int, int]) -> int:
    field, i, j = site
    return int(site_rank(2 * (i + origin[0]) + (field == 1), 2 * (j + origin[1]) + (field == 2)))


def are_neighbours(state: State, a: Site, b: Site, integrated: bool) -> bool:
    """Whether one term of the energy holds both, from its definition."""
    cliques = [[(1, 0, -1), (1, 0, 0), (1, 0, 1)], [(2, -1, 0), (2, 0, 0), (2, 1, 0)]]
    cliques += [[(1, -1, 0), (1, 0, 0), (1, 1, 0)], [(2, 0, -1), (2, 0, 0), (2, 0, 1)]]
    cliques += [[(1, i, 0), (2, 0, j)] for i in (-1, 0) for j in (-1, 0)]
    if integrated:
        cliques += [[(0, 0, 0), (0, 1, 0), (1, 0, 0)], [(0, 0, 0), (0, 0, 1), (2, 0, 0)]]
    return any(
        p[0] == a[0] and q[0] == b[0] and (q[1] - p[1], q[2] - p[2]) == (b[1] - a[1], b[2] - a[2])
        for clique in cliques
        for p in clique
        for q in clique
    )


def parallel_hcf(
    state: State, model: EdgeModel, rounds: int, origin: tuple[int, int], *, integrated: bool, sure: bool
) -> tuple[int, int]:
    """Change the state; return the rounds made and the sites that still want to change."""
    all_sites = sites(state, integrated)
    near = {a: [b for b in all_sites if a != b and are_neighbours(state, a, b, integrated)] for a in all_sites}
    if not integrated and sure:
        for site in all_sites:
            if between_equals(state, site):
                state.fields[site[0]][site[1:]] = 0
    found = {site: stability(state, site, model, sure) for site in all_sites}
    made = 0
    while made < rounds and any(g < np.inf for g, _ in found.values()):
        keys = {site: (round(g, 4), rank(site, origin)) for site, (g, _) in found.items()}
        least = [
            site
            for site, (g, _) in found.items()
            if g == -np.inf or (g < np.inf and all(keys[site] < keys[other] for other in near[site]))
        ]
        for site in least:
            state.fields[site[0]][site[1:]] = found[site][1]
        for site in {*least, *(other for one in least for other in near[one])}:
            found[site] = stability(state, site, model, sure)
        made += 1
    left = [site for site, (g, _) in found.items() if g < np.inf or state.fields[site[0]][site[1:]] == 255]
    for field, i, j in left:
        if state.fields[field][i, j] == 255:
            value = 0 if field else min(max(round(float(state.y[i, j])), 0), model.levels - 1)
            state.fields[field][i, j] = value
    return made, len(left)
