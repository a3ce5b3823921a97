"""Schedule of simulated annealing (Geman & Geman 1984)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.compiled import rule
from tilepipe_kernels.core.random import as_seed
from tilepipe_kernels.core.rounding import nearest_integer

_LEAST = -700.0
_PER_LN2 = 1 / math.log(2)
_LN2_HIGH = 0.6931471803691238
_LN2_LOW = 1.9082149292705877e-10
_BIAS = np.int64(1023)
_FRACTION_BITS = np.uint64(52)


@dataclass(frozen=True)
class Annealing:
    """Schedule of temperatures: geometric from `hot` to `cold`.

    A state of a site that costs e more than its best is drawn exp(-e/temperature) times as often.  The defaults are
    for energies whose terms are about 1, as those of `edge_model` are.  With costs of about 20 they are nearly a
    quench, mere descent: `hot` should then be of the size of the cost of one pair of unequal labels, `cold` a
    twentieth of it.

    Parameters
    ----------
    sweeps
        Draws of every site.
    hot, cold
        First and last temperature, in units of the energy.
    seed
        Of the random numbers, which depend on nothing else but the site and the sweep.

    Raises
    ------
    ValueError
        For no sweep, temperatures that are not hot >= cold > 0, a seed out of range.

    Examples
    --------
    >>> from tilepipe_kernels.mrf.annealing import Annealing
    >>> Annealing(sweeps=4, hot=8.0, cold=1.0).temperatures().round(3).tolist()
    [8.0, 4.0, 2.0, 1.0]
    """

    sweeps: int = 100
    hot: float = 1.0
    cold: float = 0.05
    seed: int = 0

    def __post_init__(self) -> None:
        if self.sweeps < 1:
            raise ValueError(f"annealing needs 1 sweep or more, not {self.sweeps}")
        if not 0 < self.cold <= self.hot < math.inf:
            raise ValueError(f"temperatures must fall: hot >= cold > 0, not {self.hot} and {self.cold}")
        as_seed(self.seed)

    def temperatures(self) -> NDArray[np.float64]:
        """Temperature of each sweep."""
        return np.geomspace(self.hot, self.cold, self.sweeps)


@rule
def boltzmann_factor(excess: float, temperature: float) -> float:
    """exp(-excess/temperature) of an energy of 0 or more above the least, in float64; 0 below 1e-304.

    It is 2ᵏ times the Taylor polynomial of degree 12 of what is left: only products and sums, so that every backend
    draws the same labels.  Relative error below 1e-15.
    """
    x = -excess / temperature
    if not x > _LEAST:
        return 0.0
    k = nearest_integer(np.float64(x * _PER_LN2))
    r = (x - k * _LN2_HIGH) - k * _LN2_LOW
    q = r * r
    even = 1.0 / 40320 + q * (1.0 / 3628800 + q * (1.0 / 479001600))
    even = 1.0 + q * (1.0 / 2 + q * (1.0 / 24 + q * (1.0 / 720 + q * even)))
    odd = 1.0 / 5040 + q * (1.0 / 362880 + q * (1.0 / 39916800))
    odd = 1.0 + q * (1.0 / 6 + q * (1.0 / 120 + q * odd))
    power = np.uint64(np.uint64(np.int64(k) + _BIAS) << _FRACTION_BITS).view(np.float64)
    return power * (even + r * odd)
