"""Energy of labels and line elements, term by term from their definition, in plain Python."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.mrf.edge_model import EdgeModel


def energy(
    y: NDArray[np.float32], x: NDArray[np.uint8], h: NDArray[np.uint8] | None, v: NDArray[np.uint8] | None,
    model: EdgeModel,
) -> float:  # fmt: skip
    rows, columns = y.shape

    def data(i: int, j: int) -> bool:
        return 0 <= i < rows and 0 <= j < columns and not math.isnan(y[i, j])

    def label(i: int, j: int) -> int | None:
        return int(x[i, j]) if data(i, j) and x[i, j] != 255 else None

    def element(field: NDArray[np.uint8] | None, i: int, j: int) -> int | None:
        di, dj = (1, 0) if field is h else (0, 1)
        if field is None or not (data(i, j) and data(i + di, j + dj)) or field[i, j] == 255:
            return None
        return int(field[i, j])

    def f(d: float) -> float:
        return d**2 if model.potential == "quadratic" else -1 / (1 + abs(d))

    def known(*values: Any) -> bool:
        return all(value is not None for value in values)

    total = 0.0
    for i in range(-2, rows + 2):
        for j in range(-2, columns + 2):
            here = label(i, j)
            if here is not None:
                total += (float(y[i, j]) - here) ** 2 / (2 * model.sigma**2)
            for field, (di, dj) in ((h, (1, 0)), (v, (0, 1))):
                there = label(i + di, j + dj)
                e = element(field, i, j)
                if here is not None and there is not None:
                    total += model.beta * f(here - there)
                    if e is not None:
                        total += model.alpha * (here - there) ** 2 * (1 - e)
                before, after = element(field, i - dj, j - di), element(field, i + dj, j + di)
                if known(before, e, after):
                    total += model.gamma * e * abs(before - after)  # type: ignore[operator]
                above, below = element(field, i - di, j - dj), element(field, i + di, j + dj)
                if known(above, e, below):
                    total += model.zeta * above * e * below  # type: ignore[operator]
            for across in (element(h, i - 1, j), element(h, i, j)):
                for along in (element(v, i, j - 1), element(v, i, j)):
                    if known(across, along):
                        total += model.xi * across * along  # type: ignore[operator]
    return total
