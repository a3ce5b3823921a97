"""Arrays and functions that stand for those of a device where numba simulates CUDA (``NUMBA_ENABLE_CUDASIM=1``).

A `SimulatedArray` is a numpy array whose namespace has only functions that cupy has too: tests then find code that
would not run on a GPU.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
        return simulated(getattr(ufunc, method)(*map(plain, inputs), **options))

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> Any:
        if function.__name__ not in DEVICE_FUNCTIONS:
            raise TypeError(f"device code may not use numpy.{function.__name__}; see core.simulated.DEVICE_FUNCTIONS")
        if any(issubclass(kind, np.ndarray) and kind is not SimulatedArray for kind in types):
            raise TypeError(f"numpy.{function.__name__}: arrays of the host and of the device are mixed")
        # numpy's own code is not device code: inside it all arrays are plain
        return simulated(function(*plain(arguments), **{name: plain(value) for name, value in options.items()}))


def _is_host_array(value: Any) -> bool:
    return isinstance(value, np.ndarray) and not isinstance(value, SimulatedArray) and value.ndim > 0


def plain(value: Any) -> Any:
    """A simulated device array as the numpy array that it is, in a list or tuple too; anything else as it is."""
    if type(value) in (list, tuple):
        return type(value)(plain(each) for each in value)
    return value.view(np.ndarray) if isinstance(value, SimulatedArray) else value


class SimulatedNamespace:
    """The part of a module that device code may use; what it makes lies on the simulated device."""

    def __init__(self, module: Any, names: frozenset[str]) -> None:
        self._module, self._names = module, names

    def __getattr__(self, name: str) -> Any:
        if name not in self._names:
            raise AttributeError(f"device code may not use {name!r}; see core.simulated.DEVICE_FUNCTIONS")
        found = getattr(self._module, name)
        if isinstance(found, type) or not callable(found):
            return found

        def on_simulated_device(*arguments: Any, **options: Any) -> Any:
            return simulated(found(*arguments, **options))

        return on_simulated_device


def simulated(result: Any) -> Any:
    """A host array, or each array of a tuple, as one of the simulated device."""
    if isinstance(result, tuple):
        return tuple(simulated(each) for each in result)
    return result.view(SimulatedArray) if isinstance(result, np.ndarray) else result


SIMULATED_NUMPY = SimulatedNamespace(np, DEVICE_FUNCTIONS)


def simulating() -> bool:
    """Whether numba simulates CUDA in this process."""
    return os.environ.get("NUMBA_ENABLE_CUDASIM", "0") not in ("", "0")
