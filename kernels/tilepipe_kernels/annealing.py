"""Schedule of simulated annealing (Geman & Geman 1984)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .random import as_seed


@dataclass(frozen=True)
class Annealing:
    """Schedule of temperatures: geometric from `hot` to `cold`.

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
