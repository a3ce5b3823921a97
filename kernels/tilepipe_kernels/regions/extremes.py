"""Lowest and highest value of each label."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.arrays import on_device
from tilepipe_kernels.core.compiled import device_form, loop


def label_extremes(labels: NDArray[np.int32], values: NDArray[Any], count: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Lowest and highest value of each label of a block.

    Parameters
    ----------
    labels
        int32, shape (rows, columns): 1 … ``count``; 0 is left out.
    values
        Same shape, of a real dtype, without NaN where a label is; on a device int32 or int64.
    count
        Number of labels; each occurs.

    Returns
    -------
    lowest, highest
        Of the values' dtype, shape (count,).  Arrays of a device stay there.

    Raises
    ------
    ValueError
        For values on a device that are not int32 or int64.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.regions.extremes import label_extremes
    >>> lowest, highest = label_extremes(np.array([[1, 1, 2, 0]], np.int32), np.array([[5, 9, 7, 99]]), count=2)
    >>> lowest.tolist(), highest.tolist()
    ([5, 7], [9, 7])
    """
    if on_device(labels, values):
        return device_form(__name__).label_extremes(labels, values, count)
    return _extremes(labels, np.ascontiguousarray(values), np.zeros(count + 1, np.bool_))


@loop
def _extremes(
    labels: NDArray[np.int32], values: NDArray[Any], seen: NDArray[np.bool_]
) -> tuple[NDArray[Any], NDArray[Any]]:
    lowest, highest = np.zeros(seen.size - 1, values.dtype), np.zeros(seen.size - 1, values.dtype)
    for i in range(labels.shape[0]):
        for j in range(labels.shape[1]):
            label, value = labels[i, j], values[i, j]
            if label == 0:
                continue
            k = label - 1
            if not seen[label]:
                seen[label] = True
                lowest[k] = highest[k] = value
            elif value < lowest[k]:
                lowest[k] = value
            elif value > highest[k]:
                highest[k] = value
    return lowest, highest
