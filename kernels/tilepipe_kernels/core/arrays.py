"""Where an array lives, and the functions that make and join arrays there.

A kernel's public function takes arrays of either kind and gives back the kind it took.  numpy arrays lie in the memory
of the host, cupy arrays in that of a GPU; nothing moves between them but by `to_device` and `to_host`.

Where numba simulates CUDA, a `core.simulated.SimulatedArray` stands for a cupy array.  This is the one module that
imports cupy.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tilepipe_kernels.core.simulated import SIMULATED_NUMPY, SimulatedArray, SimulatedNamespace, simulating

Backend = Literal["numpy", "cupy"]


_FILTERS = frozenset(("minimum_filter", "maximum_filter", "gaussian_filter", "uniform_filter"))


def on_device(*arrays: Any) -> bool:
    """Whether arrays lie on a device.

    Raises
    ------
    TypeError
        Where some do and some do not: nothing moves silently.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.core.arrays import on_device
    >>> on_device(np.zeros(3), None, np.ones(3))  # None stands for an array that was not given
    False
    """
    found = {_is_device_array(array) for array in arrays if array is not None}
    if len(found) > 1:
        raise TypeError("arrays of the host and of the device are mixed; move them by to_device or to_host first")
    return found == {True}


def _is_device_array(array: Any) -> bool:
    kind = type(array)
    return kind is SimulatedArray or kind.__module__.partition(".")[0] == "cupy"


def namespace(*arrays: Any) -> Any:
    """Module with the array functions for arrays of one kind: numpy, or cupy.

    Examples
    --------
    A formula that is written once for both kinds of arrays.

    >>> import numpy as np
    >>> from tilepipe_kernels.core.arrays import namespace
    >>> def slope(right, down):
    ...     return namespace(right, down).hypot(right, down)
    >>> slope(np.array([3.0, 0.0]), np.array([4.0, 1.0])).tolist()
    [5.0, 1.0]
    """
    return device_namespace() if on_device(*arrays) else np


def as_array(values: Any) -> NDArray[Any]:
    """Array of what a caller gives: a device array as it is, anything else on the host.

    Examples
    --------
    >>> from tilepipe_kernels.core.arrays import as_array
    >>> as_array([[1, 2], [3, 4]]).shape
    (2, 2)
    """
    return values if on_device(values) else np.asarray(values)


def device_namespace() -> Any:
    """cupy, or what stands for it where CUDA is simulated.

    Raises
    ------
    ValueError
        Where there is no cupy, or no device that it can use; the message says which.
    """
    if simulating():
        return SIMULATED_NUMPY
    reason = why_no_device()
    if reason:
        raise ValueError(reason)
    import cupy

    return cupy


def image_filters(*arrays: Any) -> Any:
    """scipy.ndimage for arrays of the host, cupyx.scipy.ndimage for those of a device: what both have alike."""
    from scipy import ndimage  # a tenth of a second that most runs need not spend

    if not on_device(*arrays):
        return ndimage
    if simulating():
        return SimulatedNamespace(ndimage, _FILTERS)
    from cupyx.scipy import ndimage as device_ndimage

    return device_ndimage


def why_no_device() -> str:
    """Why there is no GPU to compute on; empty where there is one."""
    try:
        import cupy
    except ImportError as error:
        return f"cupy cannot be imported ({error}): pip install '.[gpu]' in the checkout brings it"
    try:
        count = cupy.cuda.runtime.getDeviceCount()
    except cupy.cuda.runtime.CUDARuntimeError as error:
        return f"cupy finds no usable NVIDIA GPU ({error})"
    return "" if count else "cupy finds no NVIDIA GPU"


def choose_backend(wanted: str) -> Backend:
    """The backend that ``auto`` means here, or the one that is wanted.

    Raises
    ------
    ValueError
        For ``cupy`` where it cannot work, and for an unknown name.

    Examples
    --------
    >>> from tilepipe_kernels.core.arrays import choose_backend
    >>> choose_backend("numpy")
    'numpy'
    >>> choose_backend("torch")
    Traceback (most recent call last):
        ...
    ValueError: backend 'torch' is unknown: use auto, numpy or cupy
    """
    if wanted == "numpy":
        return "numpy"
    if wanted == "cupy":
        device_namespace()
        return "cupy"
    if wanted == "auto":
        # a simulation is for tests, and never what somebody wants who leaves the choice open
        return "numpy" if simulating() or why_no_device() else "cupy"
    raise ValueError(f"backend {wanted!r} is unknown: use auto, numpy or cupy")


def to_device(array: NDArray[Any]) -> Any:
    """Copy of a host array on the device; a device array as it is."""
    if on_device(array):
        return array
    if simulating():
        return np.array(array).view(SimulatedArray)
    return device_namespace().asarray(np.ascontiguousarray(array))


def to_backend(array: NDArray[Any], backend: Backend) -> Any:
    """Array of a backend: as it is for numpy, on the device for cupy.

    Examples
    --------
    >>> import numpy as np
    >>> from tilepipe_kernels.core.arrays import to_backend
    >>> heights = np.array([3.0, 4.0])
    >>> to_backend(heights, "numpy") is heights  # nothing is copied
    True
    """
    return to_device(array) if backend == "cupy" else array


def to_host(array: Any) -> NDArray[Any]:
    """Copy of a device array on the host; a host array as it is."""
    return array.get() if on_device(array) else array
