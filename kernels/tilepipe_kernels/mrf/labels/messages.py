"""Min-sum messages on a labelling problem: what a site's neighbourhood as a whole would have its label be.

Reweighted message passing (Wainwright, Jaakkola & Willsky 2005; as min-sum in Kolmogorov 2006, eq. 3):

    M_st(x_t) = min over x_s of  U_s(x_s) + ρ Σ_r M_rs(x_s) - M_ts(x_s) + w_st V_st(x_s, x_t)/ρ,  less its least value;

each site takes the label that minimises U + ρ Σ M.  The grid is the mean of two forests, its rows and its columns:
every site is in both, every pair in one, so trees weigh ρ = 1/2.  Messages that begin with those of coarser grids
(`mrf.labels.scales`) take ρ = 19/32, which forgets less of them on the way; ρ = 1 would be belief propagation.  The
sites of one colour of the checkerboard send at a time: a message then never waits for another of its own round, and n
rounds carry no farther than n pixels.

Arrays hold ρ M, the two colours of each row apart, one plane for each label, so that loops run over adjacent floats.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.mrf.labels.problem import Field, Floats, Labelling
from tilepipe_kernels.mrf.labels.scales import coarser, hand_down, reach
from tilepipe_kernels.mrf.labels.stability import site_energy

FROM_ABOVE, FROM_LEFT, FROM_RIGHT, FROM_BELOW = range(4)
"""Sides that a message comes from."""

_TREES = np.float32(0.5)
_SCALES = np.float32(0.59375)
_ONE = np.float32(1)
_INFINITY = np.float32(np.inf)
_AT_ONCE = 4
_BAND_BYTES = 1 << 26
_DEVICE_BAND_BYTES = 1 << 30

Planes = NDArray[np.float32]


class _Parted(NamedTuple):
    """Costs of a block, the colours of each row apart: unary (rows, 2, K, n); kinds and weights of pairs (rows, 2, n).

    Weights are (rows, 2, 0) where all are 1.
    """

    unary: Planes
    down: Field
    right: Field
    down_weight: Planes
    right_weight: Planes


@rule
def lower(a: np.float32, b: np.float32) -> np.float32:
    """The lower of two numbers."""
    return a if a < b else b


@loop
def _add_least(least: Floats, sent: Floats, cost: Floats) -> None:
    """Least = min(least, min over four labels of sent + cost)."""
    a, b, c, d = sent[0], sent[1], sent[2], sent[3]
    cost_a, cost_b, cost_c, cost_d = cost[0], cost[1], cost[2], cost[3]
    for n in range(least.size):
        first = lower(a[n] + cost_a, b[n] + cost_b)
        second = lower(c[n] + cost_c, d[n] + cost_d)
        least[n] = lower(least[n], lower(first, second))


@loop
def _add_weighted_least(least: Floats, sent: Floats, cost: Floats, weight: Floats) -> None:
    """As `_add_least`, with the weight of each pair."""
    a, b, c, d = sent[0], sent[1], sent[2], sent[3]
    cost_a, cost_b, cost_c, cost_d = cost[0], cost[1], cost[2], cost[3]
    for n in range(least.size):
        first = lower(a[n] + weight[n] * cost_a, b[n] + weight[n] * cost_b)
        second = lower(c[n] + weight[n] * cost_c, d[n] + weight[n] * cost_d)
        least[n] = lower(least[n], lower(first, second))


@loop
def _collect(total: Floats, unary: Floats, incoming: Planes, rho: np.float32) -> None:
    """ρ (U + ρ Σ M) of a row; incoming is (4, labels, sites)."""
    for label in range(unary.shape[0]):
        a, b, c, d = incoming[0, label], incoming[1, label], incoming[2, label], incoming[3, label]
        u, into = unary[label], total[label]
        for n in range(into.size):
            into[n] = rho * site_energy(u[n], a[n], b[n], c[n], d[n])


@loop
def _subtract(sent: Floats, total: Floats, back: Floats) -> None:
    """ρ (U + ρ Σ M - M) of a row, the message back left out."""
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
def _send(
    message: Floats, sent: Floats, tables: Planes, kinds: Field, weights: Floats, least: Floats, lowest: Floats
) -> None:
    """Send to one neighbour of each site of a row; tables are V by kind, (T, labels to, labels from padded)."""
    for kind in range(tables.shape[0]):
        lowest[:] = _INFINITY
        for label in range(message.shape[0]):
            into = least[label]
            into[:] = _INFINITY
            for start in range(0, sent.shape[0], _AT_ONCE):
                four, cost = sent[start : start + _AT_ONCE], tables[kind, label, start : start + _AT_ONCE]
                if weights.size > 0:
                    _add_weighted_least(into, four, cost, weights)
                else:
                    _add_least(into, four, cost)
            for n in range(into.size):
                lowest[n] = lower(lowest[n], into[n])
        _deliver(message, least, lowest, kinds, kind)


@loop
def _exchange(messages: Planes, parted: _Parted, tables: Planes, rounds: int, row: int, rho: np.float32) -> None:
    """Pass messages (rows, 4, 2, K, n) for some rounds; the first row's global place is `row`."""
    unary, down, right, w_down, w_right = parted
    rows, _, labels, n = unary.shape
    total = np.empty((labels, n - 2), np.float32)
    sent = np.full((tables.shape[2], n - 2), _INFINITY)
    least, lowest = np.empty((labels, n - 2), np.float32), np.empty(n - 2, np.float32)
    here = slice(1, n - 1)
    for turn in range(rounds):
        for i in range(1, rows - 1):
            q = (row + i + turn) % 2
            own = messages[i, :, q, :, 1 : n - 1]
            left, onward = slice(q, n - 2 + q), slice(1 + q, n - 1 + q)
            _collect(total, unary[i, q, :, 1 : n - 1], own, rho)
            _subtract(sent, total, own[FROM_ABOVE])
            into = messages[i - 1, FROM_BELOW, q, :, 1 : n - 1]
            _send(into, sent, tables, down[i - 1, q, here], w_down[i - 1, q, here], least, lowest)
            _subtract(sent, total, own[FROM_BELOW])
            into = messages[i + 1, FROM_ABOVE, q, :, 1 : n - 1]
            _send(into, sent, tables, down[i, q, here], w_down[i, q, here], least, lowest)
            _subtract(sent, total, own[FROM_LEFT])
            into = messages[i, FROM_RIGHT, 1 - q, :, left]
            _send(into, sent, tables, right[i, 1 - q, left], w_right[i, 1 - q, left], least, lowest)
            _subtract(sent, total, own[FROM_RIGHT])
            into = messages[i, FROM_LEFT, 1 - q, :, onward]
            _send(into, sent, tables, right[i, q, here], w_right[i, q, here], least, lowest)


@loop
def _decide(labels: Field, unary: Planes, messages: Planes) -> None:
    """Label of least belief, the lowest of equals, of each site; labels (rows, 2, n)."""
    rows, _, count, n = unary.shape
    total = np.empty((count, n), np.float32)
    least = np.empty(n, np.float32)
    for row in range(2 * rows):
        i, q = row // 2, row % 2
        _collect(total, unary[i, q], messages[i, :, q], _ONE)
        best = labels[i, q]
        for m in range(n):
            least[m] = total[0, m]
            best[m] = 0
        for label in range(1, count):
            belief = total[label]
            for m in range(n):
                best[m] = np.uint8(label) if belief[m] < least[m] else best[m]
                least[m] = lower(least[m], belief[m])


def _colours(stride: int, shift: int) -> Iterator[tuple[int, slice, slice]]:
    """Each colour, its columns of a framed row, and their places among those of the colour.

    A column j has the colour (j + shift) % 2 and the place (j + shift) // 2.
    """
    for first in range(2):
        place = (first + shift) // 2
        yield (first + shift) % 2, slice(first, stride, 2), slice(place, place + (stride - first + 1) // 2)


def _parted(problem: Labelling, shift: int) -> _Parted:
    """Part the costs of a block into the colours of its columns."""
    xp = namespace(problem.exists)
    rows, stride, count = problem.exists.size // problem.stride, problem.stride, problem.unary.shape[1]
    n = (stride + shift) // 2 + 2
    unary = xp.zeros((rows, 2, count, n), xp.float32)
    kinds = [xp.full((rows, 2, n), len(problem.tables) - 1, xp.uint8) for _ in range(2)]
    of_pairs = problem.down_weight, problem.right_weight
    weights = [xp.zeros((rows, 2, 0 if given is None else n), xp.float32) for given in of_pairs]
    fields = [(problem.down, kinds[0]), (problem.right, kinds[1]), *zip(of_pairs, weights, strict=True)]
    for colour, columns, places in _colours(stride, shift):
        unary[:, colour, :, places] = problem.unary.reshape(rows, stride, count)[:, columns].transpose(0, 2, 1)
        for given, parted in fields:
            if given is not None:
                parted[:, colour, places] = given.reshape(rows, stride)[:, columns]
    return _Parted(unary, *kinds, *weights)


def _shift(problem: Labelling) -> int:
    # Two columns more on the left keep the places of the colours at 1 or more.
    return 2 + problem.column % 2


def _messages(problem: Labelling, rounds: int, scales: int, rho: np.float32) -> tuple[Planes, Planes]:
    """Unary costs and messages of a block, parted, after some rounds on each grid, the coarsest first."""
    xp = namespace(problem.exists)
    parted = _parted(problem, _shift(problem))
    rows, _, count, n = parted.unary.shape
    messages: Planes = xp.zeros((rows, 4, 2, count, n), xp.float32)
    if scales > 0:
        coarse = coarser(problem)
        _, from_messages = _messages(coarse, rounds, scales - 1, rho)
        hand_down(problem, messages, _shift(problem), coarse, from_messages, _shift(coarse))
    if on_device(messages):
        device_form(__name__).exchange(messages, parted, problem.tables, rounds, problem.row, rho)
        return parted.unary, messages
    tables = np.zeros((len(problem.tables) - 1, count, -(-count // _AT_ONCE) * _AT_ONCE), np.float32)
    tables[:, :, :count] = problem.tables[:-1, :count]
    _exchange(messages, parted, tables, rounds, problem.row, rho)
    return parted.unary, messages


def _part_of(weights: Floats | None, sites: slice) -> Floats | None:
    return None if weights is None else weights[sites]


def _band(problem: Labelling, first: int, last: int) -> Labelling:
    """The framed rows first..last, as if these were all."""
    sites = slice(first * problem.stride, last * problem.stride)
    return problem._replace(
        unary=problem.unary[sites], down=problem.down[sites], right=problem.right[sites],
        down_weight=_part_of(problem.down_weight, sites), right_weight=_part_of(problem.right_weight, sites),
        exists=problem.exists[sites], row=problem.row + first,
    )  # fmt: skip


def _band_labels(problem: Labelling, rounds: int, scales: int) -> Field:
    """Labels of a framed band, (rows, stride)."""
    unary, messages = _messages(problem, rounds, scales, _SCALES if scales else _TREES)
    rows, _, _, n = unary.shape
    xp = namespace(messages)
    parted = xp.empty((rows, 2, n), xp.uint8)
    decide = device_form(__name__).decide if on_device(messages) else _decide
    decide(parted, unary, messages)
    labels: Field = xp.empty((rows, problem.stride), xp.uint8)
    for colour, columns, places in _colours(problem.stride, _shift(problem)):
        labels[:, columns] = parted[:, colour, places]
    return labels


def message_labels(problem: Labelling, rounds: int, scales: int = 0) -> Field:
    """Labels that the messages of some rounds decide on.

    Parameters
    ----------
    problem
        The costs.
    rounds
        Rounds on each grid: in each, the sites of one colour send to their four neighbours.
    scales
        Coarser grids whose messages those of the next finer one begin with.  A label depends on the costs within
        ``mrf.labels.scales.reach(rounds, scales)`` pixels.

    Returns
    -------
    ndarray of uint8
        (sites,), framed and flat; K where there is no data.
    """
    none, stride = problem.unary.shape[1], problem.stride
    xp = namespace(problem.exists)
    rows = problem.exists.size // stride
    labels = xp.empty((rows, stride), xp.uint8)
    # Bands bound the memory; each is computed with its halo, so they do not show.
    around = reach(rounds, scales) + 1
    most = _DEVICE_BAND_BYTES if on_device(problem.exists) else _BAND_BYTES
    height = max(most // (20 * none * stride), 4 * around)
    for first in range(0, rows, height):
        top, bottom = max(first - around, 0), min(first + height + around, rows)
        end = min(first + height, rows)
        band = _band_labels(_band(problem, top, bottom), rounds, scales)
        labels[first:end] = band[first - top : end - top]
    flat: Field = xp.where(problem.exists, labels.reshape(-1), xp.uint8(none))
    return flat
