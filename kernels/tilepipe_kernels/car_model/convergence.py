"""Has a chain converged, and how many independent draws is it worth: rank-normalised split R-hat and bulk ESS.

Vehtari, Gelman, Simpson, Carpenter & Bürkner (2021), "Rank-normalization, folding, and localization: an improved
R-hat".  Every chain is cut in two halves; draws are replaced by normal scores of their ranks, so that heavy tails
and infinite variances do no harm.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

Draws = NDArray[np.float64]


def split_halves(chains: ArrayLike) -> Draws:
    """Cut each chain in two; the middle draw of an odd number is left out.

    Parameters
    ----------
    chains
        Real, shape (draws,) or (chains, draws); at least 4 draws, finite.

    Returns
    -------
    ndarray of float64, shape (2 chains, draws // 2)

    Raises
    ------
    ValueError
        For another shape, fewer draws, or draws that are not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.car_model.convergence import split_halves
    >>> split_halves(np.arange(9.0)).tolist()
    [[0.0, 1.0, 2.0, 3.0], [5.0, 6.0, 7.0, 8.0]]
    """
    array: NDArray[Any] = np.atleast_2d(np.asarray(chains, dtype=np.float64))
    if array.ndim != 2 or array.shape[0] < 1 or array.shape[1] < 4:
        raise ValueError(f"chains must have the shape (chains, draws) with 4 draws or more, not {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError("chains must be finite")
    half = array.shape[1] // 2
    return np.concatenate([array[:, :half], array[:, -half:]])


def rank_normalise(draws: Draws) -> Draws:
    """Normal scores of the ranks over all chains, ties sharing their mean rank (equation 14, Blom's offset 3/8).

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.car_model.convergence import rank_normalise
    >>> rank_normalise(np.array([[3.0, 1.0, 1000.0]])).round(2).tolist()  # an outlier is no more than the last
    [[0.0, -0.87, 0.87]]
    """
    _, place, count = np.unique(draws, return_inverse=True, return_counts=True)
    last = np.cumsum(count)
    rank = last - (count - 1) / 2
    return np.asarray(ndtri((rank[place.reshape(draws.shape)] - 0.375) / (draws.size + 0.25)))


def _variances(draws: Draws) -> tuple[float, float]:
    """Mean variance within chains, and the pooled estimate var⁺ of the posterior variance (equations 1 to 3)."""
    n = draws.shape[1]
    within = float(draws.var(axis=1, ddof=1).mean())
    return within, within * (n - 1) / n + float(draws.mean(axis=1).var(ddof=1))


def _reduction(draws: Draws) -> float:
    within, pooled = _variances(draws)
    return float("inf") if within == 0.0 else (pooled / within) ** 0.5


def split_rhat(chains: ArrayLike) -> float:
    """Rank-normalised split R-hat: the larger of that of the draws and of their distances to the median.

    Parameters
    ----------
    chains
        As for `split_halves`.

    Returns
    -------
    float
        Near 1 for converged chains (advised: below 1.01); infinite for halves that stand still at different
        values; NaN if all draws are equal, for then nothing can be said.

    Raises
    ------
    ValueError
        As `split_halves`.

    Examples
    --------
    Two chains about 0 agree; one about 3 does not belong to them.

    >>> import numpy as np
    >>> from tilepipe_kernels.car_model.convergence import split_rhat
    >>> from tilepipe_kernels.core.random import normals
    >>> chains = normals(np.arange(1000).reshape(2, 500), seed=0)
    >>> split_rhat(chains) < 1.01, split_rhat(chains + [[0.0], [3.0]]) < 1.01
    (True, False)
    """
    halves = split_halves(chains)
    if (halves == halves[0, 0]).all():
        return float("nan")
    folded = np.abs(halves - np.median(halves))
    location = _reduction(rank_normalise(halves))
    return location if (folded == folded[0, 0]).all() else max(location, _reduction(rank_normalise(folded)))


def _autocovariances(draws: Draws) -> Draws:
    """Biased autocovariances of each chain, shape (chains, draws), by the fast Fourier transform."""
    n = draws.shape[1]
    spectrum = np.fft.rfft(draws - draws.mean(axis=1, keepdims=True), n=2 * n, axis=1)
    return np.asarray(np.fft.irfft(np.abs(spectrum) ** 2, n=2 * n, axis=1)[:, :n] / n)


def _effective_size(draws: Draws) -> float:
    """Effective sample size by Geyer's initial monotone sequence over the joint autocorrelations (equations 9-13)."""
    chains, n = draws.shape
    within, pooled = _variances(draws)
    covariance = _autocovariances(draws).mean(axis=0) * n / (n - 1)
    correlation = 1.0 - (within - covariance) / pooled
    correlation[0] = 1.0
    pairs = correlation[: n // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0)
    pairs = pairs[: negative[0] if negative.size else None]
    time = -1.0 + 2.0 * float(np.minimum.accumulate(pairs).sum())
    size = chains * n
    # Antithetic chains can be worth more than their length, but no more than this can be told.
    return float(size / max(time, 1.0 / np.log10(size)))


def effective_sample_size(chains: ArrayLike) -> float:
    """Bulk effective sample size of rank-normalised split chains.

    Parameters
    ----------
    chains
        As for `split_halves`.

    Returns
    -------
    float
        Number of independent draws that would tell the centre of the posterior as well (advised: 100 a chain or
        more); NaN if all draws are equal.

    Raises
    ------
    ValueError
        As `split_halves`.

    Examples
    --------
    A chain of 500 draws each of which stands for ten sweeps is worth a tenth.

    >>> import numpy as np
    >>> from tilepipe_kernels.car_model.convergence import effective_sample_size
    >>> from tilepipe_kernels.core.random import normals
    >>> draws = normals(np.arange(500), seed=0)
    >>> round(effective_sample_size(draws), -2), round(effective_sample_size(np.repeat(draws[:50], 10)), -1)
    (500.0, 40.0)
    """
    halves = split_halves(chains)
    if (halves == halves[0, 0]).all():
        return float("nan")
    return _effective_size(rank_normalise(halves))
