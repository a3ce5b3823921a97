"""`mrf.labels.messages` on the device: a thread for every site that sends."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.mrf.labels.messages import FROM_ABOVE, FROM_BELOW, FROM_LEFT, FROM_RIGHT, lower
from tilepipe_kernels.mrf.labels.problem import MAXIMUM_LABELS
from tilepipe_kernels.mrf.labels.stability import site_energy

_INFINITY = np.float32(np.inf)
_ONE = np.float32(1)
_FEW = 16


@cuda.jit(device=True)
def _belief(unary: Any, messages: Any, i: int, q: int, m: int, label: int) -> np.float32:
    return site_energy(
        unary[i, q, label, m], messages[i, FROM_ABOVE, q, label, m], messages[i, FROM_LEFT, q, label, m],
        messages[i, FROM_RIGHT, q, label, m], messages[i, FROM_BELOW, q, label, m],
    )  # fmt: skip


@cuda.jit(device=True)
def _send(
    messages: Any, own: tuple[int, int, int], back: int, to: tuple[int, int, int], side: int, total: Any, sent: Any,
    tables: Any, kind: int, weights: Any, pair: tuple[int, int, int],
) -> None:  # fmt: skip
    """Send from a site, `back` being the side that the other one sends to, to one side of another, both (i, q, m)."""
    if kind == tables.shape[0] - 1:
        return
    weight = weights[pair] if weights.size > 1 else _ONE
    labels = messages.shape[3]
    for label in range(labels):
        sent[label] = total[label] - messages[own[0], back, own[1], label, own[2]]
    lowest = _INFINITY
    for heard in range(labels):
        least = _INFINITY
        for label in range(labels):
            least = lower(least, sent[label] + weight * tables[kind, heard, label])
        messages[to[0], side, to[1], heard, to[2]] = least
        lowest = lower(lowest, least)
    for heard in range(labels):
        messages[to[0], side, to[1], heard, to[2]] -= lowest


@cuda.jit(device=True)
def _send_all(
    messages: Any, unary: Any, down: Any, right: Any, w_down: Any, w_right: Any, tables: Any, i: int, q: int, m: int,
    rho: np.float32, total: Any, sent: Any,
) -> None:  # fmt: skip
    """Send from a site to its four neighbours; `total` and `sent` have room for all labels."""
    for label in range(unary.shape[2]):
        total[label] = rho * _belief(unary, messages, i, q, m, label)
    own, up = (i, q, m), (i - 1, q, m)
    left, onward = (i, 1 - q, m - 1 + q), (i, 1 - q, m + q)
    _send(messages, own, FROM_ABOVE, up, FROM_BELOW, total, sent, tables, down[up], w_down, up)
    _send(messages, own, FROM_BELOW, (i + 1, q, m), FROM_ABOVE, total, sent, tables, down[own], w_down, own)
    _send(messages, own, FROM_LEFT, left, FROM_RIGHT, total, sent, tables, right[left], w_right, left)
    _send(messages, own, FROM_RIGHT, onward, FROM_LEFT, total, sent, tables, right[own], w_right, own)


@grid
def _send_few(
    count: int, messages: Any, unary: Any, down: Any, right: Any, w_down: Any, w_right: Any, tables: Any, first: int,
    rho: np.float32,
) -> None:  # fmt: skip
    total, sent = cuda.local.array(_FEW, numba.float32), cuda.local.array(_FEW, numba.float32)
    across = unary.shape[3] - 2
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, m = 1 + p // across, 1 + p % across
        q = (first + i) % 2
        _send_all(messages, unary, down, right, w_down, w_right, tables, i, q, m, rho, total, sent)


@grid
def _send_many(
    count: int, messages: Any, unary: Any, down: Any, right: Any, w_down: Any, w_right: Any, tables: Any, first: int,
    rho: np.float32,
) -> None:  # fmt: skip
    total, sent = cuda.local.array(MAXIMUM_LABELS, numba.float32), cuda.local.array(MAXIMUM_LABELS, numba.float32)
    across = unary.shape[3] - 2
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, m = 1 + p // across, 1 + p % across
        q = (first + i) % 2
        _send_all(messages, unary, down, right, w_down, w_right, tables, i, q, m, rho, total, sent)


def exchange(messages: Any, parted: tuple[Any, ...], tables: Any, rounds: int, row: int, rho: np.float32) -> None:
    """Pass messages for some rounds, as `mrf.labels.messages` does; tables are those of the problem."""
    unary, down, right, *weights = parted
    one = namespace(messages).ones((1, 1, 1), np.float32)
    w_down, w_right = (weight if weight.size else one for weight in weights)
    rows, _, labels, n = unary.shape
    send = _send_few if labels <= _FEW else _send_many
    for turn in range(rounds):
        send((rows - 2) * (n - 2), messages, unary, down, right, w_down, w_right, tables, row + turn, rho)


@grid
def _decide(count: int, labels: Any, unary: Any, messages: Any) -> None:
    n = unary.shape[3]
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        i, q, m = p // (2 * n), p // n % 2, p % n
        least = _belief(unary, messages, i, q, m, 0)
        best = 0
        for label in range(1, unary.shape[2]):
            belief = _belief(unary, messages, i, q, m, label)
            best = label if belief < least else best
            least = lower(least, belief)
        labels[i, q, m] = best


def decide(labels: Any, unary: Any, messages: Any) -> None:
    """Write the label of least belief of each site."""
    _decide(labels.size, labels, unary, messages)
