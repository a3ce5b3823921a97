"""Min-sum messages on a labelling problem: what a site's neighbourhood as a whole would have its label be.

Tree-reweighted message passing (Wainwright, Jaakkola & Willsky 2005; as min-sum in Kolmogorov 2006, eq. 3).  The grid
is the mean of two forests, its rows and its columns: every site is in both, every pair in one, so ρ = 1/2 and

    M_st(x_t) = min over x_s of  U_s(x_s) + ρ Σ_r M_rs(x_s) - M_ts(x_s) + V_st(x_s, x_t)/ρ,   less its least value;

each site takes the label that minimises U + ρ Σ M.  The sites of one colour of the checkerboard send at a time: a
message then never waits for another of its own round, and n rounds carry no farther than n pixels.

Arrays hold the two colours of each row apart, one plane for each label, so that loops run over adjacent floats.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .compiled import loop, rule
from .labelling import Field, Floats, Labelling

_FROM_ABOVE, _FROM_LEFT, _FROM_RIGHT, _FROM_BELOW = range(4)
_RHO = np.float32(0.5)
_INFINITY = np.float32(np.inf)
_AT_ONCE = 4
_BAND_BYTES = 1 << 26

Planes = NDArray[np.float32]


@rule
def _lower(a: np.float32, b: np.float32) -> np.float32:
    return a if a < b else b


@loop
def _add_least(least: Floats, sent: Floats, cost: Floats) -> None:
    """Least = min(least, min over four labels of sent + cost)."""
    a, b, c, d = sent[0], sent[1], sent[2], sent[3]
    cost_a, cost_b, cost_c, cost_d = cost[0], cost[1], cost[2], cost[3]
    for n in range(least.size):
        first = _lower(a[n] + cost_a, b[n] + cost_b)
        second = _lower(c[n] + cost_c, d[n] + cost_d)
        least[n] = _lower(least[n], _lower(first, second))


@loop
def _collect(total: Floats, unary: Floats, incoming: Planes) -> None:
    """U + ρ Σ M of a row; incoming is (4, labels, sites)."""
    for label in range(unary.shape[0]):
        a, b, c, d = incoming[0, label], incoming[1, label], incoming[2, label], incoming[3, label]
        u, into = unary[label], total[label]
        for n in range(into.size):
            into[n] = u[n] + _RHO * ((a[n] + b[n]) + (c[n] + d[n]))


@loop
def _subtract(sent: Floats, total: Floats, back: Floats) -> None:
    for label in range(total.shape[0]):
        s, t, m = sent[label], total[label], back[label]
        for n in range(s.size):
            s[n] = t[n] - m[n]


@loop
def _deliver(message: Floats, least: Floats, lowest: Floats, kind: Field, this: int) -> None:
    """Write the messages of the pairs of one kind."""
    chosen = np.uint8(this)
    for label in range(message.shape[0]):
        into, value = message[label], least[label]
        for n in range(into.size):
            into[n] = value[n] - lowest[n] if kind[n] == chosen else into[n]


@loop
def _send(message: Floats, sent: Floats, tables: Planes, kinds: Field, least: Floats, lowest: Floats) -> None:
    """Send to one neighbour of each site of a row; tables are V/ρ by kind, (T, labels to, labels from padded)."""
    for kind in range(tables.shape[0]):
        lowest[:] = _INFINITY
        for label in range(message.shape[0]):
            into = least[label]
            into[:] = _INFINITY
            for start in range(0, sent.shape[0], _AT_ONCE):
                _add_least(into, sent[start : start + _AT_ONCE], tables[kind, label, start : start + _AT_ONCE])
            for n in range(into.size):
                lowest[n] = _lower(lowest[n], into[n])
        _deliver(message, least, lowest, kinds, kind)


@loop
def _exchange(
    unary: Planes, messages: Planes, down: Field, right: Field, tables: Planes, rounds: int, row: int
) -> None:
    """Pass messages for some rounds; unary (rows, 2, K, n), messages (rows, 4, 2, K, n), kinds (rows, 2, n)."""
    rows, _, labels, n = unary.shape
    total = np.empty((labels, n - 2), np.float32)
    sent = np.full((tables.shape[2], n - 2), _INFINITY)
    least, lowest = np.empty((labels, n - 2), np.float32), np.empty(n - 2, np.float32)
    for turn in range(rounds):
        for i in range(1, rows - 1):
            q = (row + i + turn) % 2
            left, onward = 1 - q, q
            own = messages[i, :, q, :, 1 : n - 1]
            _collect(total, unary[i, q, :, 1 : n - 1], own)
            _subtract(sent, total, own[_FROM_ABOVE])
            into = messages[i - 1, _FROM_BELOW, q, :, 1 : n - 1]
            _send(into, sent, tables, down[i - 1, q, 1 : n - 1], least, lowest)
            _subtract(sent, total, own[_FROM_BELOW])
            into = messages[i + 1, _FROM_ABOVE, q, :, 1 : n - 1]
            _send(into, sent, tables, down[i, q, 1 : n - 1], least, lowest)
            _subtract(sent, total, own[_FROM_LEFT])
            into = messages[i, _FROM_RIGHT, 1 - q, :, 1 - left : n - 1 - left]
            _send(into, sent, tables, right[i, 1 - q, 1 - left : n - 1 - left], least, lowest)
            _subtract(sent, total, own[_FROM_RIGHT])
            into = messages[i, _FROM_LEFT, 1 - q, :, 1 + onward : n - 1 + onward]
            _send(into, sent, tables, right[i, q, 1 : n - 1], least, lowest)


@loop
def _decide(labels: Field, unary: Planes, messages: Planes) -> None:
    """Label of least belief, the lowest of equals, of each site of a row; labels (2, n)."""
    count, n = unary.shape[1], unary.shape[2]
    total = np.empty((count, n), np.float32)
    least = np.empty(n, np.float32)
    for q in range(2):
        _collect(total, unary[q], messages[:, q])
        best = labels[q]
        for m in range(n):
            least[m] = total[0, m]
            best[m] = 0
        for label in range(1, count):
            belief = total[label]
            for m in range(n):
                best[m] = np.uint8(label) if belief[m] < least[m] else best[m]
                least[m] = _lower(least[m], belief[m])


@loop
def _part_kinds(kinds: Field, shift: int, parted: NDArray[np.uint8]) -> None:
    """Part the colours of kinds (rows, columns) into (rows, 2, n)."""
    for i in range(kinds.shape[0]):
        for j in range(kinds.shape[1]):
            parted[i, (j + shift) % 2, (j + shift) // 2] = kinds[i, j]


@loop
def _part_unary(unary: Planes, shift: int, parted: Planes) -> None:
    """Part the colours of unary (rows, columns, K) into (rows, 2, K, n)."""
    for i in range(unary.shape[0]):
        for j in range(unary.shape[1]):
            for label in range(unary.shape[2]):
                parted[i, (j + shift) % 2, label, (j + shift) // 2] = unary[i, j, label]


@loop
def _join(parted: Field, shift: int, labels: Field) -> None:
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            labels[i, j] = parted[i, (j + shift) % 2, (j + shift) // 2]


def _band(problem: Labelling, tables: Planes, first: int, last: int, rounds: int) -> Field:
    """Labels of the framed rows first..last, as if these were all."""
    stride, count = problem.stride, problem.unary.shape[1]
    rows = last - first
    sites = slice(first * stride, last * stride)
    # Two columns more on the left keep the places of the colours at 1 or more.
    shift = 2 + problem.column % 2
    n = (stride + shift) // 2 + 2
    unary = np.zeros((rows, 2, count, n), np.float32)
    _part_unary(problem.unary[sites].reshape(rows, stride, count), shift, unary)
    kinds = []
    for field in (problem.down, problem.right):
        kinds.append(np.full((rows, 2, n), len(tables), np.uint8))
        _part_kinds(field[sites].reshape(rows, stride), shift, kinds[-1])
    messages = np.zeros((rows, 4, 2, count, n), np.float32)
    _exchange(unary, messages, kinds[0], kinds[1], tables, rounds, problem.row + first)
    parted = np.empty((rows, 2, n), np.uint8)
    for i in range(rows):
        _decide(parted[i], unary[i], messages[i])
    labels = np.empty((rows, stride), np.uint8)
    _join(parted, shift, labels)
    return labels


def message_labels(problem: Labelling, rounds: int) -> Field:
    """Labels that the messages of some rounds decide on.

    Parameters
    ----------
    problem
        The costs.
    rounds
        Rounds: in each, the sites of one colour send to their four neighbours.  A label depends on the costs within
        ``rounds`` pixels.

    Returns
    -------
    ndarray of uint8
        (sites,), framed and flat; K where there is no data.
    """
    none = problem.unary.shape[1]
    padded = -(-none // _AT_ONCE) * _AT_ONCE
    tables = np.zeros((len(problem.tables) - 1, none, padded), np.float32)
    tables[:, :, :none] = problem.tables[:-1, :none] / _RHO
    labels = np.full((problem.exists.size // problem.stride, problem.stride), none, np.uint8)
    rows = len(labels)
    # Bands bound the memory; each is computed with its halo, so they do not show.
    height = max(_BAND_BYTES // (20 * none * problem.stride), 4 * rounds + 1)
    for first in range(0, rows, height):
        top, bottom = max(first - rounds - 1, 0), min(first + height + rounds + 1, rows)
        end = min(first + height, rows)
        labels[first:end] = _band(problem, tables, top, bottom, rounds)[first - top : end - top]
    flat = labels.reshape(-1)
    flat[~problem.exists] = none
    return flat
