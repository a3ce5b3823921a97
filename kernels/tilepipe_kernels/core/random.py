"""Random numbers as pure functions of (seed, site, sweep, stream), so that no order of work can change them.

Philox4x32-10 of Salmon et al. (2011), "Parallel random numbers: as easy as 1, 2, 3", enciphers a counter of 128
bits under a key of 64.  Here the key is the seed, and the counter is the site (64 bits), the sweep (32) and the
stream (32): what tells apart the draws of one site in one sweep.  Words of 32 bits are held in uint64, where their
products fit and where lanes line up with those of float64, so that loops over the rules vectorise.  All draws but those
of gamma shapes below 1 take only arithmetic and roots: they are the same bits on a device.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, inlined_rule, loop, rule

Words = tuple[np.uint64, np.uint64, np.uint64, np.uint64]

_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_MULTIPLIER_0 = np.uint64(0xD2511F53)
_MULTIPLIER_1 = np.uint64(0xCD9E8D57)
_WEYL_0 = np.uint64(0x9E3779B9)
_WEYL_1 = np.uint64(0xBB67AE85)

_FRACTION_BITS = np.uint64(52)
_FRACTION = np.uint64((1 << 52) - 1)
_ONE = np.uint64(0x3FF << 52)
_SHIFT_20 = np.uint64(20)
_SHIFT_12 = np.uint64(12)
_NEXT = np.uint64(1)
_EXPONENT_OF_ONE = np.int64(1023)

_LN2 = math.log(2)
_SQRT2 = math.sqrt(2)

GAMMA_STREAM = np.uint64(1 << 31)
"""First stream of `gamma`; streams below are free for other draws of the same site and sweep."""


# ------------------------------------------------------------------------------------------------- words


@inlined_rule
def philox_4x32(c0: np.uint64, c1: np.uint64, c2: np.uint64, c3: np.uint64, k0: np.uint64, k1: np.uint64) -> Words:
    """Encipher one counter: ten rounds of Philox4x32.

    Parameters
    ----------
    c0, c1, c2, c3, k0, k1
        Words of the counter and of the key: uint64 below 2³².

    Returns
    -------
    tuple of uint64
        Four words below 2³², as in Random123's ``philox4x32_R(10, ...)``.
    """
    for _ in range(10):
        first = c0 * _MULTIPLIER_0
        second = c2 * _MULTIPLIER_1
        c0 = (second >> _HALF) ^ c1 ^ k0
        c1 = second & _LOW
        c2 = (first >> _HALF) ^ c3 ^ k1
        c3 = first & _LOW
        k0 = (k0 + _WEYL_0) & _LOW
        k1 = (k1 + _WEYL_1) & _LOW
    return c0, c1, c2, c3


@inlined_rule
def random_words(seed: np.uint64, site: np.uint64, sweep: np.uint64, stream: np.uint64) -> Words:
    """Four words of 32 random bits for a draw; `sweep` and `stream` are below 2³²."""
    return philox_4x32(site & _LOW, site >> _HALF, sweep, stream, seed & _LOW, seed >> _HALF)


# ------------------------------------------------------------------------------------------------- distributions


@inlined_rule
def unit_from_words(high: np.uint64, low: np.uint64) -> np.float64:
    """Uniform float64 in the open interval (0, 1): the centres of 2⁵² equal cells."""
    bits = (high << _SHIFT_20) | (low >> _SHIFT_12) | _ONE
    return (np.uint64(bits).view(np.float64) - 1.0) + 2.0**-53


@inlined_rule
def log_of_unit(u: np.float64) -> np.float64:
    """Natural logarithm of a normal float64 by log m = 2 artanh((m - 1)/(m + 1)); relative error below 1e-14.

    The truncated series needs only arithmetic, so it vectorises and is the same bits with any mathematics library.
    """
    bits = np.float64(u).view(np.uint64)
    exponent = np.int64(bits >> _FRACTION_BITS) - _EXPONENT_OF_ONE
    m = np.uint64((bits & _FRACTION) | _ONE).view(np.float64)
    large = m > _SQRT2
    m = m * 0.5 if large else m
    e = np.float64(np.int32(exponent)) + (1.0 if large else 0.0)
    s = (m - 1.0) / (m + 1.0)
    q = s * s
    series = 2.0 / 17 + q * (2.0 / 19)
    series = 2.0 / 13 + q * (2.0 / 15 + q * series)
    series = 2.0 / 9 + q * (2.0 / 11 + q * series)
    series = 2.0 / 5 + q * (2.0 / 7 + q * series)
    return e * _LN2 + s * (2.0 + q * (2.0 / 3 + q * series))


@inlined_rule
def sine_of_half_turns(t: np.float64) -> np.float64:
    """sin(pi t) for -1/2 <= t <= 1/2 by its Taylor series to the 19th power; error below 1e-15."""
    x = math.pi * t
    q = x * x
    series = 1.0 / 355687428096000 - q * (1.0 / 121645100408832000)
    series = 1.0 / 6227020800 - q * (1.0 / 1307674368000 - q * series)
    series = 1.0 / 362880 - q * (1.0 / 39916800 - q * series)
    series = 1.0 / 120 - q * (1.0 / 5040 - q * series)
    return x * (1.0 - q * (1.0 / 6 - q * series))


@inlined_rule
def uniform(seed: np.uint64, site: np.uint64, sweep: np.uint64, stream: np.uint64) -> np.float64:
    """Uniform draw in the open interval (0, 1), of 52 bits."""
    high, low, _, _ = random_words(seed, site, sweep, stream)
    return unit_from_words(high, low)


@inlined_rule
def normal(seed: np.uint64, site: np.uint64, sweep: np.uint64, stream: np.uint64) -> np.float64:
    """Standard normal draw by Box and Muller (1958), exact to rounding up to 8.5 standard deviations.

    The cosine of a uniform angle is distributed as the sine of one within a quarter turn of zero, which needs no
    reduction of its argument.
    """
    a, b, c, d = random_words(seed, site, sweep, stream)
    radius = math.sqrt(-2.0 * log_of_unit(unit_from_words(a, b)))
    return radius * sine_of_half_turns(unit_from_words(c, d) - 0.5)


@rule
def gamma(shape: float, seed: np.uint64, site: np.uint64, sweep: np.uint64) -> float:
    """Gamma draw of unit rate by squeeze-free rejection, Marsaglia & Tsang (2000); shape > 0.

    Each attempt takes two streams from `GAMMA_STREAM` on; shapes below 1 are drawn at shape + 1 and multiplied by
    a uniform to the power 1/shape (their section 6).
    """
    d = (shape if shape >= 1.0 else shape + 1.0) - 1.0 / 3.0
    c = 1.0 / math.sqrt(9.0 * d)
    stream = GAMMA_STREAM
    while True:
        z = normal(seed, site, sweep, stream)
        u = uniform(seed, site, sweep, stream + _NEXT)
        stream = stream + _NEXT + _NEXT
        w = 1.0 + c * z
        if w > 0.0:
            cube = w * w * w
            if log_of_unit(u) < 0.5 * z * z + d * (1.0 - cube + log_of_unit(cube)):
                break
    if shape >= 1.0:
        return d * cube
    return d * cube * math.exp(log_of_unit(uniform(seed, site, sweep, stream)) / shape)


# ------------------------------------------------------------------------------------------------- arrays


@loop
def fill_normals(
    sites: NDArray[np.int64], seed: np.uint64, sweep: np.uint64, stream: np.uint64, result: NDArray[np.float64]
) -> None:
    """Write the `normal` of each site into `result`."""
    for i in range(sites.size):
        result[i] = normal(seed, np.uint64(sites[i]), sweep, stream)


@loop
def _fill_uniforms(
    sites: NDArray[np.int64], seed: np.uint64, sweep: np.uint64, stream: np.uint64, result: NDArray[np.float64]
) -> None:
    for i in range(sites.size):
        result[i] = uniform(seed, np.uint64(sites[i]), sweep, stream)


def as_seed(seed: int) -> np.uint64:
    """Check a seed: an integer of 0 to 2⁶⁴ - 1.

    Raises
    ------
    ValueError
        For a seed outside this range.

    Examples
    --------
    >>> from tilepipe_kernels.core.random import as_seed
    >>> int(as_seed(2**64 - 1))
    18446744073709551615
    >>> as_seed(-1)
    Traceback (most recent call last):
        ...
    ValueError: seed must be an integer from 0 to 2**64 - 1, not -1
    """
    if not 0 <= seed < 2**64:
        raise ValueError(f"seed must be an integer from 0 to 2**64 - 1, not {seed}")
    return np.uint64(seed)


def _checked(
    sites: ArrayLike, seed: int, sweep: int, stream: int
) -> tuple[NDArray[np.int64], np.uint64, np.uint64, np.uint64]:
    if not (0 <= sweep < 2**32 and 0 <= stream < 2**31):
        raise ValueError(f"sweep must be from 0 to 2**32 - 1 and stream from 0 to 2**31 - 1, not {sweep}, {stream}")
    xp = namespace(sites)
    array: NDArray[np.int64] = xp.ascontiguousarray(sites, dtype=xp.int64)
    return array, as_seed(seed), np.uint64(sweep), np.uint64(stream)


def normals(sites: ArrayLike, seed: int, sweep: int = 0, stream: int = 0) -> NDArray[np.float64]:
    """Standard normal draw of each site.

    Parameters
    ----------
    sites
        Global ids, any shape, cast to int64; on a device the draws are made there.
    seed, sweep, stream
        What else the draw is a function of: below 2⁶⁴, 2³² and 2³¹.

    Returns
    -------
    ndarray of float64
        Shape of `sites`; the value of a site depends on nothing but the arguments and its id.

    Raises
    ------
    ValueError
        For a seed, sweep or stream out of its range.

    Examples
    --------
    The draw of a pixel is the same in whatever order pixels come, and alone.

    >>> import numpy as np
    >>> from tilepipe_kernels.core.random import normals
    >>> draws = normals(np.arange(100_000), seed=7)
    >>> print(f"mean {draws.mean():.2f}, standard deviation {draws.std():.2f}")
    mean 0.00, standard deviation 1.00
    >>> bool(normals([41, 40], seed=7)[1] == draws[40])
    True
    """
    array, key, at, by = _checked(sites, seed, sweep, stream)
    result: NDArray[np.float64] = namespace(array).empty(array.shape)
    if on_device(array):
        device = device_form(__name__)
        device.fill_normals(array.size, array.reshape(-1), key, at, by, result.reshape(-1))
    else:
        fill_normals(array.reshape(-1), key, at, by, result.reshape(-1))
    return result


def uniforms(sites: ArrayLike, seed: int, sweep: int = 0, stream: int = 0) -> NDArray[np.float64]:
    """Uniform draw in (0, 1) of each site; arguments and errors as `normals`.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.core.random import uniforms
    >>> np.histogram(uniforms(np.arange(100_000), seed=7), bins=4, range=(0, 1))[0].round(-3).tolist()
    [25000, 25000, 25000, 25000]
    >>> bool(uniforms(12, seed=7, sweep=1) == uniforms(12, seed=7, sweep=2))  # each sweep draws anew
    False
    """
    array, key, at, by = _checked(sites, seed, sweep, stream)
    result: NDArray[np.float64] = namespace(array).empty(array.shape)
    if on_device(array):
        device = device_form(__name__)
        device.fill_uniforms(array.size, array.reshape(-1), key, at, by, result.reshape(-1))
    else:
        _fill_uniforms(array.reshape(-1), key, at, by, result.reshape(-1))
    return result
