"""`framed` on the device: the sites that exist, and what they begin with."""

from __future__ import annotations

from typing import Any

from tilepipe_kernels.core.compiled import grid
from tilepipe_kernels.core.cuda import cuda
from tilepipe_kernels.mrf.lines.framed import first_element


@grid
def _begin(count: int, has_data: Any, width: int, with_labels: bool, sure: bool, exists: Any, state: Any) -> None:
    for p in range(cuda.grid(1), count, cuda.gridsize(1)):
        h, v = count + p, 2 * count + p
        # nothing in the frame has data, so that what lies beyond it is not looked at
        here = has_data[p]
        down = here and has_data[p + width]
        right = here and has_data[p + 1]
        exists[p], exists[h], exists[v] = here and with_labels, down, right
        if sure and here:
            state[h] = first_element(down, state[p], state[p + width])
            state[v] = first_element(right, state[p], state[p + 1])


def begin(has_data: Any, exists: Any, state: Any, with_labels: bool, sure: bool) -> None:
    """Mark the sites of framed fields that exist and can change; commit the sure elements."""
    _begin(
        has_data.size, has_data.reshape(-1), has_data.shape[1], with_labels, sure, exists.reshape(-1),
        state.reshape(-1),
    )  # fmt: skip
