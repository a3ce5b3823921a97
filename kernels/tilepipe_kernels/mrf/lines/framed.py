"""A block of labels and line elements with a frame around it, ready to be minimised, and what comes out of it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import namespace, on_device
from tilepipe_kernels.core.compiled import device_form, loop, rule
from tilepipe_kernels.mrf.edge_model import UNCOMMITTED, EdgeModel, Field, Floats, Window
from tilepipe_kernels.mrf.lines.energies import Block, Frame, Marks, Weights, energy_tables
from tilepipe_kernels.mrf.lines.sites import FRAME, H, Neighbourhoods, V, X, neighbourhoods

_INNER = slice(FRAME, -FRAME)
_ZERO = np.uint8(0)


@loop
def _existing(has_data: Marks, exists: NDArray[np.bool_], with_labels: bool) -> None:
    """Mark the sites of the framed fields that exist and can change."""
    for i in range(has_data.shape[0] - 1):
        for j in range(has_data.shape[1] - 1):
            here = has_data[i, j]
            exists[X, i, j] = here & with_labels
            exists[H, i, j] = here & has_data[i + 1, j]
            exists[V, i, j] = here & has_data[i, j + 1]


@rule
def first_element(exists: bool, a: np.uint8, b: np.uint8) -> np.uint8:
    """Element between two labels to begin with: 0 where it is sure, uncommitted elsewhere."""
    return _ZERO if exists & (a != UNCOMMITTED) & (a == b) else UNCOMMITTED


@loop
def _commit_sure(exists: NDArray[np.bool_], state: NDArray[np.uint8]) -> None:
    """Commit the sure elements: those between equal labels to 0."""
    labels = state[X]
    for i in range(labels.shape[0] - 1):
        for j in range(labels.shape[1] - 1):
            state[H, i, j] = first_element(exists[H, i, j], labels[i, j], labels[i + 1, j])
            state[V, i, j] = first_element(exists[V, i, j], labels[i, j], labels[i, j + 1])


class FramedSites(NamedTuple):
    """A block ready to be minimised."""

    block: Block
    weights: Weights
    near: Neighbourhoods
    shape: tuple[int, int]

    def _unframed(self, flat: NDArray[Any]) -> NDArray[Any]:
        """The three fields of a flat array without their frames."""
        framed = flat.reshape(3, self.shape[0] + 2 * FRAME, self.shape[1] + 2 * FRAME)
        return framed[:, _INNER, _INNER]

    def fields(self) -> list[Field]:
        """X, H and V without their frames; 0 where there is no element."""
        xp = namespace(self.block.state)
        x, h, v = (xp.ascontiguousarray(field) for field in self._unframed(self.block.state))
        exists = self._unframed(self.block.exists)
        h[~exists[H]] = v[~exists[V]] = 0
        return [x, h, v]

    def commit(self, wanting: Marks) -> Marks:
        """Commit what the cap on the rounds left over, elements to 0, labels to the nearest; mark all unresolved."""
        state, observed, plane = self.block.state, self.block.observed, self.block.frame.plane
        # the host looks once whether anything is left over
        if not bool(wanting.any()):
            return wanting
        xp = namespace(state)
        left = self.block.exists & (state == UNCOMMITTED)
        state[plane:][left[plane:]] = 0
        if observed.size:
            pixels = left[:plane]
            state[:plane][pixels] = xp.clip(xp.rint(observed[pixels]), 0, self.weights.levels - 1).astype(np.uint8)
        unresolved: Marks = wanting | left
        return unresolved

    def count_in(self, marks: Marks, core: Window) -> int:
        """How many of the marked sites lie in the core."""
        return int(namespace(marks).count_nonzero(self._unframed(marks)[:, *core]))


def framed_sites(
    labels: Field, observed: Floats | None, model: EdgeModel, origin: tuple[int, int], sure: bool
) -> FramedSites:
    """Frame a block: of labels that are given, or only begun with where there are observed grey values."""
    xp = namespace(labels, observed)
    shape = (labels.shape[0], labels.shape[1])
    near = neighbourhoods(model, integrated=observed is not None)
    framed = shape[0] + 2 * FRAME, shape[1] + 2 * FRAME
    if 3 * framed[0] * framed[1] >= 2**31:
        raise ValueError(f"a block of {shape} pixels is too large: make tiles of at most 26000 pixels a side")
    state = xp.full((3, *framed), UNCOMMITTED, dtype=np.uint8)
    exists = xp.zeros(state.shape, dtype=np.bool_)
    state[X, _INNER, _INNER] = labels
    grey = xp.empty(0, dtype=np.float32)
    if observed is not None:
        grey = xp.pad(observed, FRAME, constant_values=np.nan)
        state[X][xp.isnan(grey)] = UNCOMMITTED
    has_data = state[X] != UNCOMMITTED if observed is None else ~xp.isnan(grey)
    if on_device(state):
        device_form(__name__).begin(has_data, exists, state, observed is not None, sure)
    else:
        _existing(has_data, exists, observed is not None)
        if sure:
            _commit_sure(exists, state)
    frame = Frame(framed[0] * framed[1], framed[1], origin[0] - FRAME, origin[1] - FRAME)
    offsets, bounds = (xp.asarray(each) for each in near.offsets(shape))
    ranks = xp.empty(state.size, dtype=np.uint32)
    fields = state.reshape(-1), grey.reshape(-1), exists.reshape(-1)
    block = Block(*fields, offsets, ranks, bounds, xp.asarray(energy_tables(model)), frame)
    return FramedSites(block, Weights.of(model, sure), near, shape)
