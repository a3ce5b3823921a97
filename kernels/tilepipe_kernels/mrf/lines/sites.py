"""Which sites of the coupled fields speak to which: neighbourhoods, their reach and colour classes, from the terms.

A *site* is a label or a line element; the three fields X (labels), H and V (elements) have the shape of the raster.
A *clique* is the set of sites of one term of the energy (`mrf.edge_model`), and two sites are neighbours when a term of
weight other than 0 holds both.  So a model without a term has a smaller reach, and its tiles a smaller halo.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.mrf.edge_model import EdgeModel

X, H, V = 0, 1, 2
FRAME = 2
"""Sites around a block that hold no value, so that every neighbour of a site has an address."""

Site = tuple[int, int, int]
"""Field, row and column."""

_PAIR: list[list[Site]] = [[(X, 0, 0), (X, 1, 0)], [(X, 0, 0), (X, 0, 1)]]
_CONTRAST: list[list[Site]] = [[(X, 0, 0), (X, 1, 0), (H, 0, 0)], [(X, 0, 0), (X, 0, 1), (V, 0, 0)]]
_CONTINUITY: list[list[Site]] = [[(H, 0, -1), (H, 0, 0), (H, 0, 1)], [(V, -1, 0), (V, 0, 0), (V, 1, 0)]]
_CORNERS: list[list[Site]] = [[(H, i, 0), (V, 0, j)] for i in (-1, 0) for j in (-1, 0)]
_PARALLELS: list[list[Site]] = [[(H, -1, 0), (H, 0, 0), (H, 1, 0)], [(V, 0, -1), (V, 0, 0), (V, 0, 1)]]


def cliques(model: EdgeModel) -> list[list[Site]]:
    """Sites of every term of the model that an element or label at (0, 0) is in, up to translation.

    An element waits for its labels, so that they are neighbours even where contrast has no weight.
    """
    weighted = (
        (model.beta, _PAIR),
        (model.gamma, _CONTINUITY),
        (model.xi, _CORNERS),
        (model.zeta, _PARALLELS),
    )
    return [*_CONTRAST, *(clique for weight, kind in weighted for clique in kind if weight > 0)]


@dataclass(frozen=True)
class Neighbourhoods:
    """Neighbours of a site of each field, as far as they can change.

    Attributes
    ----------
    neighbours
        For the fields X, H and V: (field, rows down, columns right) of each neighbour, ascending.
    fields
        The fields that can change: H and V, in the integrated form X too.
    """

    neighbours: tuple[tuple[Site, ...], tuple[Site, ...], tuple[Site, ...]]
    fields: tuple[int, ...]

    @property
    def reach(self) -> int:
        """Rows or columns from a site to its farthest neighbour."""
        return max((max(abs(i), abs(j)) for field in self.neighbours for _, i, j in field), default=0)

    def moduli(self) -> tuple[int, ...]:
        """Colour classes of each changing field: those of equal (row + column) modulo the smallest that will do.

        No two sites of one class of one field are neighbours.
        """
        return tuple(self._modulus(field) for field in self.fields)

    def _modulus(self, field: int) -> int:
        apart = [i + j for other, i, j in self.neighbours[field] if other == field]
        return next(m for m in range(1, 4 * FRAME + 2) if all(d % m for d in apart))

    def offsets(self, shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Neighbours as differences of flat addresses in the framed fields of a block.

        Returns
        -------
        offsets, bounds
            int64: those of field f are ``offsets[bounds[f]:bounds[f + 1]]``.
        """
        width = shape[1] + 2 * FRAME
        plane = (shape[0] + 2 * FRAME) * width
        pairs = [(f, other) for f in (X, H, V) for other in self.neighbours[f]]
        flat = [(g - f) * plane + i * width + j for f, (g, i, j) in pairs]
        bounds = np.cumsum([0] + [len(self.neighbours[f]) for f in (X, H, V)])
        return np.array(flat, np.int64), bounds.astype(np.int64)


def neighbourhoods(model: EdgeModel, *, integrated: bool = False) -> Neighbourhoods:
    """Find the neighbours of a site of each field.

    Parameters
    ----------
    model
        Weights of the terms; a term of weight 0 makes no neighbours.
    integrated
        Whether labels can change too, or are given.

    Returns
    -------
    Neighbourhoods

    Examples
    --------
    >>> from tilepipe_kernels.mrf.edge_model import EdgeModel
    >>> from tilepipe_kernels.mrf.lines.sites import neighbourhoods
    >>> [len(near) for near in neighbourhoods(EdgeModel(), integrated=True).neighbours]  # of a label, of h, of v
    [8, 14, 14]
    >>> [len(near) for near in neighbourhoods(EdgeModel()).neighbours]  # labels given
    [0, 12, 12]
    """
    fields = (X, H, V) if integrated else (H, V)
    found: list[set[Site]] = [set(), set(), set()]
    for clique in cliques(model):
        for field, row, column in clique:
            if field in fields:
                others = ((g, i - row, j - column) for g, i, j in clique if g in fields)
                found[field].update(other for other in others if other != (field, 0, 0))
    x, h, v = (tuple(sorted(each)) for each in found)
    return Neighbourhoods((x, h, v), fields)
