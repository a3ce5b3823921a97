"""Optimisers of a labelling problem in plain Python, from their definitions; costs should be exact in float32."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.hcf import site_rank

Site = tuple[int, int]
Labelled = dict[Site, int | None]


class Problem:
    def __init__(
        self, unary: NDArray[Any], tables: NDArray[Any], down: NDArray[Any], right: NDArray[Any],
        origin: tuple[int, int] = (0, 0),
    ) -> None:  # fmt: skip
        self.unary, self.tables, self.down, self.right, self.origin = unary, tables, down, right, origin
        self.labels = range(unary.shape[2])
        self.sites = [(int(i), int(j)) for i, j in np.argwhere(~np.isnan(unary).any(axis=2))]

    def neighbours(self, s: Site) -> Iterator[tuple[Site, NDArray[Any]]]:
        for di, dj in ((-1, 0), (0, -1), (0, 1), (1, 0)):
            t = (s[0] + di, s[1] + dj)
            if t in self.sites:
                yield t, self.tables[(self.down if di else self.right)[min(s, t)]]

    def rank(self, s: Site) -> int:
        return int(site_rank(s[0] + self.origin[0], s[1] + self.origin[1]))

    def colour(self, s: Site) -> int:
        return (s[0] + s[1] + sum(self.origin)) % 2

    def local(self, x: Labelled, s: Site) -> list[float]:
        committed = [(x[t], table) for t, table in self.neighbours(s) if x[t] is not None]
        return [
            float(self.unary[s][k]) + sum(float(table[k, other]) for other, table in committed) for k in self.labels
        ]

    def stability(self, x: Labelled, s: Site) -> tuple[float, int]:
        energies = self.local(x, s)
        others = sorted((energies[k], k) for k in self.labels if k != x[s])
        own = x[s]
        return others[0][0] - (others[1][0] if own is None else energies[own]), others[0][1]

    def wanting(self, x: Labelled) -> dict[Site, tuple[float, int]]:
        all_of_them = {s: self.stability(x, s) for s in self.sites}
        return {s: found for s, found in all_of_them.items() if x[s] is None or found[0] < 0}

    def parallel(self, cap: int) -> tuple[Labelled, int, int]:
        x: Labelled = dict.fromkeys(self.sites)
        rounds = 0
        while (wanting := self.wanting(x)) and rounds < cap:
            rounds += 1
            keys = {s: (g, self.rank(s)) for s, (g, _) in wanting.items()}
            for s, key in keys.items():
                if all(key < keys.get(t, (math.inf, 0)) for t, _ in self.neighbours(s)):
                    x[s] = wanting[s][1]
        for s, (_, label) in wanting.items():
            x[s] = label if x[s] is None else x[s]
        return x, rounds, len(wanting)

    def serial(self) -> Labelled:
        x: Labelled = dict.fromkeys(self.sites)
        while wanting := self.wanting(x):
            s = min(wanting, key=lambda s: (wanting[s][0], self.rank(s)))
            x[s] = wanting[s][1]
        return x

    def cheapest(self) -> Labelled:
        return {s: int(np.argmin(self.unary[s])) for s in self.sites}

    def icm(self, cap: int) -> Labelled:
        x = self.cheapest()
        for _ in range(cap):
            for colour in range(2):
                for s in self.sites:
                    if self.colour(s) == colour and self.stability(x, s)[0] < 0:
                        x[s] = self.stability(x, s)[1]
        return x

    def messages(self, rounds: int) -> Labelled:
        sent = {(s, t): [0.0] * len(self.labels) for s in self.sites for t, _ in self.neighbours(s)}

        def belief(s: Site) -> list[float]:
            return [
                float(self.unary[s][k]) + 0.5 * sum(sent[t, s][k] for t, _ in self.neighbours(s)) for k in self.labels
            ]

        for turn in range(rounds):
            for s in self.sites:
                if self.colour(s) != turn % 2:
                    continue
                total = belief(s)
                for t, table in self.neighbours(s):
                    there = [
                        min(total[m] - sent[t, s][m] + 2 * float(table[m, k]) for m in self.labels) for k in self.labels
                    ]
                    sent[s, t] = [value - min(there) for value in there]
        return {s: int(np.argmin(belief(s))) for s in self.sites}

    def energy(self, x: NDArray[np.uint8]) -> float:
        total = 0.0
        for s in self.sites:
            total += float(self.unary[s][x[s]])
            total += sum(float(table[x[s], x[t]]) for t, table in self.neighbours(s) if t > s)
        return total

    def as_array(self, x: Labelled) -> NDArray[np.uint8]:
        result = np.full(self.unary.shape[:2], 255, np.uint8)
        for s, label in x.items():
            assert label is not None
            result[s] = label
        return result
