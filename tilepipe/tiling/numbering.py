"""Features of tiles numbered end to end.

Every tile numbers its features from 1 on; number 0 means none.  A `Numbering` lays these local numbers end to end; a
list of pairs says which of them are one feature, and `tilepipe_kernels.core.components.connected_components` gives
every number its feature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.ragged import offsets_of


@dataclass(frozen=True)
class Numbering:
    """Local feature numbers of all tiles laid end to end: feature ``n`` of tile ``t`` is ``offsets[t] + n - 1``.

    Examples
    --------
    Three tiles with 2, 0 and 3 features: those of the last one come after those of the first.

    >>> import numpy as np
    >>> from tilepipe.tiling.numbering import Numbering
    >>> numbering = Numbering.of_counts(np.array([2, 0, 3]))
    >>> numbering.total
    5
    >>> numbering.globalise(2, np.array([1, 3, 0])).tolist()
    [2, 4, -1]
    """

    offsets: NDArray[np.int64]

    @classmethod
    def of_counts(cls, counts: NDArray[np.int64]) -> Numbering:
        """From the number of features of each tile."""
        return cls(offsets_of(counts))

    @property
    def total(self) -> int:
        """Number of local features of all tiles."""
        return int(self.offsets[-1])

    def globalise(self, tile: int, numbers: NDArray[np.integer]) -> NDArray[np.int64]:
        """Global numbers of a tile's local numbers; -1 for local number 0."""
        return np.where(numbers > 0, numbers.astype(np.int64) + (self.offsets[tile] - 1), -1)
