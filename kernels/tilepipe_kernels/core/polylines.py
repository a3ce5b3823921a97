"""Polylines of different sizes in two flat arrays."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.ragged import Int64, offsets_of, reduce_runs, take_runs

Vertices = NDArray[Any]

_AT_ONCE = 1 << 14
"""Polylines whose steps are held at one time: they take several times what the vertices do."""


@dataclass(frozen=True)
class Polylines:
    """Polylines of two vertices or more; a closed one repeats its first vertex.

    Classes made of this one add columns: arrays with one row per polyline.

    Attributes
    ----------
    offsets
        int64, shape (n + 1,): polyline i has ``vertices[offsets[i]:offsets[i + 1]]``.
    vertices
        Shape (m, 2), of any real dtype: (row, column), or (x, y) in a table.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.core.polylines import Polylines
    >>> polylines = Polylines(np.array([0, 2, 5]), np.array([[0, 0], [3, 4], [0, 0], [0, 2], [2, 2]]))
    >>> polylines.lengths()
    array([5., 4.])
    >>> polylines.taken(np.array([1])).vertices.tolist()
    [[0, 0], [0, 2], [2, 2]]
    """

    offsets: Int64
    vertices: Vertices

    def __len__(self) -> int:
        return len(self.offsets) - 1

    def __iter__(self) -> Iterator[Vertices]:
        """Vertices of each."""
        for first, end in itertools.pairwise(self.offsets):
            yield self.vertices[first:end]

    @property
    def sizes(self) -> Int64:
        """Number of vertices of each, int64, shape (n,)."""
        return np.diff(self.offsets)

    @property
    def first(self) -> Vertices:
        """First vertex of each, shape (n, 2)."""
        return self.vertices[self.offsets[:-1]]

    @property
    def last(self) -> Vertices:
        """Last vertex of each, shape (n, 2)."""
        return self.vertices[self.offsets[1:] - 1]

    @property
    def ends(self) -> Vertices:
        """First and last vertex of each, one after the other: shape (2 n, 2)."""
        return self.vertices[np.stack([self.offsets[:-1], self.offsets[1:] - 1], axis=1).reshape(-1)]

    @property
    def closed(self) -> NDArray[np.bool_]:
        """Whether each ends where it begins, bool, shape (n,)."""
        closed: NDArray[np.bool_] = (self.first == self.last).all(axis=1)
        return closed

    def lengths(self, pixel_height: float = 1.0, pixel_width: float = 1.0) -> NDArray[np.float64]:
        """Length of each, float64, shape (n,), in the unit of the pixel sizes."""
        pieces = [part._lengths(pixel_height, pixel_width) for part in self.parts(_AT_ONCE)]
        return np.concatenate(pieces) if pieces else np.empty(0)

    def _lengths(self, pixel_height: float, pixel_width: float) -> NDArray[np.float64]:
        steps = np.abs(np.diff(self.vertices, axis=0, prepend=self.vertices[:1]).astype(np.float64))
        steps = np.hypot(steps[:, 0] * pixel_height, steps[:, 1] * pixel_width)
        steps[self.offsets[:-1]] = 0
        return reduce_runs(np.add, steps, self.offsets)

    def taken(self, some: NDArray[Any]) -> Self:
        """Those that are marked (bool, shape (n,)), or those of these numbers in this order, with their columns."""
        order = np.flatnonzero(some) if some.dtype == np.bool_ else some
        offsets, vertices = take_runs(order, self.offsets, self.vertices)
        columns = {name: getattr(self, name)[order] for name in self._columns()}
        return replace(self, offsets=offsets, vertices=vertices, **columns)

    def parts(self, size: int) -> Iterator[Self]:
        """All, so many at a time: views, no copies."""
        for begin in range(0, len(self), size):
            some = slice(begin, begin + size)
            offsets = self.offsets[begin : begin + size + 1]
            columns = {name: getattr(self, name)[some] for name in self._columns()}
            yield replace(
                self, offsets=offsets - offsets[0], vertices=self.vertices[offsets[0] : offsets[-1]], **columns
            )

    def with_vertices(self, kept: NDArray[np.bool_]) -> Self:
        """The same with a part of their vertices (bool, shape (m,))."""
        return replace(self, offsets=offsets_of(kept)[self.offsets], vertices=self.vertices[kept])

    @classmethod
    def concatenated(cls, parts: Sequence[Self]) -> Self:
        """All polylines of one part or more, part after part."""
        offsets = offsets_of(np.concatenate([part.sizes for part in parts]))
        names = ("vertices", *cls._columns())
        return cls(offsets, *(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    @classmethod
    def _columns(cls) -> tuple[str, ...]:
        return tuple(field.name for field in fields(cls) if field.name not in ("offsets", "vertices"))
