"""Optimisers of a labelling problem in plain Python, from their definitions; costs should be exact in float32."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.mrf.hcf import site_rank

Site = tuple[int, int]
Labelled = dict[Site, int | None]


class Problem:
    def __init__(
        self, unary: NDArray[Any], tables: NDArray[Any], down: NDArray[Any], right: NDArray[Any],
        origin: tuple[int, int] = (0, 0), down_weight: NDArray[Any] | None = None,
        right_weight: NDArray[Any] | None = None,
    ) -> None:  # fmt: skip
        self.unary, self.tables, self.down, self.right, self.origin = unary, tables, down, right, origin
        ones = np.ones(unary.shape[:2])
        self.down_weight = ones if down_weight is None else down_weight
        self.right_weight = ones if right_weight is None else right_weight
        self.labels = range(unary.shape[2])
        self.sites = [(int(i), int(j)) for i, j in np.argwhere(~np.isnan(unary).any(axis=2))]

    def neighbours(self, s: Site) -> Iterator[tuple[Site, NDArray[Any]]]:
        for di, dj in ((-1, 0), (0, -1), (0, 1), (1, 0)):
            t = (s[0] + di, s[1] + dj)
            kind = (self.down if di else self.right)[min(s, t)] if t in self.sites else -1
            # blocks can lie side by side without a pair of pixels between them
            if kind >= 0:
                yield t, (self.down_weight if di else self.right_weight)[min(s, t)] * self.tables[kind]

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

    def block(self, s: Site) -> Site:
        """Block of 2 x 2 pixels, from even global rows and columns, that a pixel is in."""
        return (s[0] + self.origin[0]) // 2 - self.origin[0] // 2, (s[1] + self.origin[1]) // 2 - self.origin[1] // 2

    def coarser(self) -> Problem:
        """Problem of the blocks: sums of costs and weights, the kind of the heaviest pair, the first of equals."""
        last = self.block((self.unary.shape[0] - 1, self.unary.shape[1] - 1))
        shape = (last[0] + 1, last[1] + 1)
        unary = np.full((*shape, len(self.labels)), np.nan)
        kinds, weights, heaviest = np.full((2, *shape), -1), np.zeros((2, *shape)), np.full((2, *shape), -1.0)
        for s in self.sites:
            unary[self.block(s)] = np.nan_to_num(unary[self.block(s)]) + self.unary[s]
        for axis, kind, weight in ((0, self.down, self.down_weight), (1, self.right, self.right_weight)):
            for s in self.sites:
                t = (s[0] + 1 - axis, s[1] + axis)
                if t in self.sites and kind[s] >= 0 and self.block(s) != self.block(t):
                    at = (axis, *self.block(s))
                    weights[at] += weight[s]
                    if weight[s] > heaviest[at]:
                        heaviest[at], kinds[at] = weight[s], kind[s]
        origin = (self.origin[0] // 2, self.origin[1] // 2)
        return Problem(unary, self.tables, kinds[0], kinds[1], origin, weights[0], weights[1])

    def sent(self, rounds: int, scales: int, rho: float) -> dict[tuple[Site, Site], list[float]]:
        """ρ times the messages after some rounds on each grid."""
        sent = {(s, t): [0.0] * len(self.labels) for s in self.sites for t, _ in self.neighbours(s)}
        if scales > 0:
            coarse = self.coarser()
            of_blocks = coarse.sent(rounds, scales - 1, rho)
            for s, t in sent:
                to = self.block(t)
                start = (to[0] + s[0] - t[0], to[1] + s[1] - t[1])
                sent[s, t] = [value / 2 for value in of_blocks.get((start, to), [0.0] * len(self.labels))]
        for turn in range(rounds):
            for s in self.sites:
                if self.colour(s) != turn % 2:
                    continue
                total = self.belief(s, sent)
                for t, table in self.neighbours(s):
                    there = [
                        min(rho * total[m] - sent[t, s][m] + float(table[m, k]) for m in self.labels)
                        for k in self.labels
                    ]
                    sent[s, t] = [value - min(there) for value in there]
        return sent

    def belief(self, s: Site, sent: dict[tuple[Site, Site], list[float]]) -> list[float]:
        return [float(self.unary[s][k]) + sum(sent[t, s][k] for t, _ in self.neighbours(s)) for k in self.labels]

    def messages(self, rounds: int, scales: int = 0) -> dict[Site, list[float]]:
        """Beliefs that the messages of some rounds on each grid lead to."""
        sent = self.sent(rounds, scales, 19 / 32 if scales else 1 / 2)
        return {s: self.belief(s, sent) for s in self.sites}

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
