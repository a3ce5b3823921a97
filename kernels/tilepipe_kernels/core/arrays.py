"""Where an array lives, and the functions that make and join arrays there.

A kernel's public function takes arrays of either kind and gives back the kind it took.  numpy arrays lie in the memory
of the host, cupy arrays in that of a GPU; nothing moves between them but by `to_device` and `to_host`.

Where numba simulates CUDA (``NUMBA_ENABLE_CUDASIM=1``, for tests), a `SimulatedArray` stands for a cupy array: it is a
numpy array whose namespace has only functions that cupy has too.  This is the one module that imports cupy.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Backend = Literal["numpy", "cupy"]

DEVICE_FUNCTIONS = frozenset(
    [
        "abs",
        "all",
        "any",
        "arange",
        "argmax",
        "argmin",
        "argsort",
        "array",
        "asarray",
        "ascontiguousarray",
        "bincount",
        "bool_",
        "broadcast_to",
        "ceil",
        "clip",
        "concatenate",
        "copyto",
        "count_nonzero",
        "cumsum",
        "diff",
        "divmod",
        "empty",
        "empty_like",
        "exp",
        "expand_dims",
        "flatnonzero",
        "floor",
        "float32",
        "float64",
        "full",
        "full_like",
        "hypot",
        "inf",
        "int16",
        "int32",
        "int64",
        "int8",
        "isinf",
        "isfinite",
        "isnan",
        "lexsort",
        "log",
        "log2",
        "logical_and",
        "logical_not",
        "logical_or",
        "matmul",
        "max",
        "maximum",
        "mean",
        "median",
        "min",
        "minimum",
        "moveaxis",
        "nan",
        "nanmax",
        "nanmin",
        "nonzero",
        "ones",
        "ones_like",
        "pad",
        "percentile",
        "ravel",
        "repeat",
        "rint",
        "round",
        "searchsorted",
        "sign",
        "sort",
        "sqrt",
        "square",
        "stack",
        "sum",
        "take",
        "tile",
        "transpose",
        "tril",
        "triu",
        "uint16",
        "uint32",
        "uint64",
        "uint8",
        "unique",
        "vstack",
        "where",
        "zeros",
        "zeros_like",
    ]
)
"""Names of numpy that cupy has with the same meaning, and that device code may use through `namespace`."""


class SimulatedArray(np.ndarray):
    """A numpy array that stands for one on the device where numba simulates CUDA.

    As cupy does, it takes no part in functions that it has no counterpart of, nor in any with arrays of the host.
    """

    def get(self) -> NDArray[Any]:
        """Copy on the host, as of a cupy array."""
        return np.array(self, subok=False)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        given = [*inputs, *options.get("out", ())]
        if strangers := [each for each in given if _is_host_array(each)]:
            raise TypeError(f"numpy.{ufunc.__name__}: host array of shape {strangers[0].shape} meets one of the device")
        if "out" in options:
            options["out"] = tuple(plain(each) for each in options["out"])
            getattr(ufunc, method)(*map(plain, inputs), **options)
            return given[-1]
        return _simulated(getattr(ufunc, method)(*map(plain, inputs), **options))

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        if function.__name__ not in DEVICE_FUNCTIONS:
            raise TypeError(f"device code may not use numpy.{function.__name__}; see arrays.DEVICE_FUNCTIONS")
        if any(issubclass(kind, np.ndarray) and kind is not SimulatedArray for kind in types):
            raise TypeError(f"numpy.{function.__name__}: arrays of the host and of the device are mixed")
        # numpy's own code is not device code: inside it all arrays are plain
        return _simulated(function(*plain(arguments), **{name: plain(value) for name, value in options.items()}))


def _is_host_array(value: Any) -> bool:
    return isinstance(value, np.ndarray) and not isinstance(value, SimulatedArray) and value.ndim > 0


def plain(value: Any) -> Any:
    """A simulated device array as the numpy array that it is, in a list or tuple too; anything else as it is."""
    if type(value) in (list, tuple):
        return type(value)(plain(each) for each in value)
    return value.view(np.ndarray) if isinstance(value, SimulatedArray) else value


class _SimulatedNamespace:
    """The part of a module that device code may use; what it makes lies on the simulated device."""

    def __init__(self, module: Any, names: frozenset[str]) -> None:
        self._module, self._names = module, names

    def __getattr__(self, name: str) -> Any:
        if name not in self._names:
            raise AttributeError(f"device code may not use {name!r}; see arrays.DEVICE_FUNCTIONS")
        found = getattr(self._module, name)
        if isinstance(found, type) or not callable(found):
            return found

        def on_simulated_device(*arguments: Any, **options: Any) -> Any:
            return _simulated(found(*arguments, **options))

        return on_simulated_device


def _simulated(result: Any) -> Any:
    if isinstance(result, tuple):
        return tuple(_simulated(each) for each in result)
    return result.view(SimulatedArray) if isinstance(result, np.ndarray) else result


_FILTERS = frozenset(("minimum_filter", "maximum_filter", "gaussian_filter", "uniform_filter"))
_SIMULATED_NAMESPACE = _SimulatedNamespace(np, DEVICE_FUNCTIONS)


def simulating() -> bool:
    """Whether numba simulates CUDA in this process."""
    return os.environ.get("NUMBA_ENABLE_CUDASIM", "0") not in ("", "0")


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
        return _SIMULATED_NAMESPACE
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
        return _SimulatedNamespace(ndimage, _FILTERS)
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


# ------------------------------------------------------------------------------------------------- device memory


def limit_device_memory(limit: int) -> None:
    """Give the memory pool of this process a limit in bytes; more than the device has is no limit.

    An array that does not fit raises an error that `is_out_of_memory` knows.
    """
    if not simulating():
        pool = device_namespace().get_default_memory_pool()
        if pool.get_limit() != limit:
            pool.set_limit(size=limit)


def device_memory() -> int:
    """Bytes of memory that the device has."""
    return 1 << 40 if simulating() else int(device_namespace().cuda.Device().mem_info[1])


_DEVICE_ERRORS = frozenset(("OutOfMemoryError", "CUDARuntimeError", "CUDADriverError", "CudaAPIError", "CUDAError"))
"""Errors of cupy, of numba and of what launches numba's grids, among them those of memory that is too small."""


def is_out_of_memory(error: BaseException) -> bool:
    """Whether an error says that the memory of the device, or its limit, is too small.

    Examples
    --------
    >>> from tilepipe_kernels.core.arrays import DeviceMemoryError, is_out_of_memory
    >>> is_out_of_memory(DeviceMemoryError()), is_out_of_memory(MemoryError("of the host"))
    (True, False)
    """
    text = str(error).lower().replace("_", " ")
    # a wrong address of memory is another matter
    too_small = "out of memory" in text or "memoryallocation" in text
    return isinstance(error, DeviceMemoryError) or (type(error).__name__ in _DEVICE_ERRORS and too_small)


class DeviceMemoryError(MemoryError):
    """The memory of the device is too small; also raised by tests, which have no device to fill."""


def free_device_memory() -> None:
    """Give back what the memory pool keeps for later."""
    if not simulating():
        device_namespace().get_default_memory_pool().free_all_blocks()


_threads = threading.local()


@contextmanager
def device_stream() -> Iterator[None]:
    """Queue this thread's work on a stream of its own, so that copies of one tile overlap with another's kernels."""
    if simulating():
        yield
        return
    stream = getattr(_threads, "stream", None)
    if stream is None:
        stream = _threads.stream = device_namespace().cuda.Stream(non_blocking=True)
    with stream:
        yield
        stream.synchronize()
