"""Histograms of tiles as facts, and their sums over a raster."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from tilepipe.tiling.facts import Facts
from tilepipe_kernels.core.arrays import namespace
from tilepipe_kernels.image.histogram import BINS


def as_facts(counted: Mapping[str, NDArray[np.int64]]) -> Facts:
    """Named histograms (`image.histogram.histogram`) by their filled bins alone."""
    facts: Facts = {}
    for name, counts in counted.items():
        bins = namespace(counts).flatnonzero(counts)
        facts |= {f"{name}:bins": bins.astype(np.int32), f"{name}:counts": counts[bins]}
    return facts


def added(facts: Iterable[Facts], name: str) -> NDArray[np.int64]:
    """Sum of the histogram of a name over all tiles.

    Parameters
    ----------
    facts
        Of all tiles, from `as_facts`, in any order.
    name
        As given to `as_facts`.

    Returns
    -------
    ndarray of int64, shape (`image.histogram.BINS`,)
        Counts.

    Examples
    --------
    The median of a raster of two tiles.

    >>> import numpy as np
    >>> from tilepipe.tiling.histograms import added, as_facts
    >>> from tilepipe_kernels.image.histogram import histogram, percentile
    >>> tiles = [np.array([10.0, 20.0]), np.array([30.0, 40.0, 50.0])]
    >>> counts = added([as_facts({"grey": histogram(values)}) for values in tiles], "grey")
    >>> percentile(counts, 50)
    30.0
    """
    counts = np.zeros(BINS, np.int64)
    for tile in facts:
        counts[tile[f"{name}:bins"]] += tile[f"{name}:counts"]
    return counts
