"""How site rules, loops and grids are compiled.

A *rule* is a scalar function of the values at one site and holds a formula once.  A *loop* walks the sites of a
block on the CPU and calls rules.  A *grid* is the CUDA form of a loop: many threads call the very same rules.
"""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeVar

import numba

from tilepipe_kernels.core.arrays import device_namespace
from tilepipe_kernels.core.cache import keep_grid, keep_loop
from tilepipe_kernels.core.simulated import plain, simulating

Function = TypeVar("Function", bound=Callable[..., Any])

THREADS = 256
"""Threads of a block of a one-dimensional grid."""

_MOST_BLOCKS = 1 << 16
_SIMULATED = (2, 3)

LAUNCHED: dict[tuple[str, str], set[tuple[Any, ...]]] = {}
"""Types of the arguments of every grid that was simulated, by module and name: tests compile each for a real device."""


def device_form(module: str) -> Any:
    """Module with the CUDA form of a kernel module, imported when an array of a device first comes in.

    Grids call the rules of the kernel modules, which therefore never import them.
    """
    package, _, name = module.rpartition(".")
    return importlib.import_module(f"{package}.device.{name}")


def rule(function: Function) -> Function:
    """Compile a scalar site rule: scalars in, scalars out, no arrays, no fast-math, so that every backend agrees."""
    return _kept(numba.njit(nogil=True, error_model="numpy")(function))


def inlined_rule(function: Function) -> Function:
    """Compile a rule into the body of its callers: too long to be inlined unasked, and only then vectorised."""
    return _kept(numba.njit(nogil=True, error_model="numpy", forceinline=True)(function))


def loop(function: Function) -> Function:
    """Compile a serial CPU loop that releases the GIL; it must stand at module level to be found in the disk cache."""
    return _kept(numba.njit(nogil=True, error_model="numpy")(function))


def _kept(compiled: Any) -> Any:
    keep_loop(compiled)
    return compiled


class Grid:
    """A CUDA kernel, compiled when it is first launched; made by the decorator `grid`.

    Its function walks the sites by ``for p in range(cuda.grid(1), count, cuda.gridsize(1))``, so that any number of
    threads does; one that needs blocks of a certain shape is launched by `blocks`.
    """

    def __init__(self, function: Callable[..., None]) -> None:
        self.function = function
        self.__doc__ = function.__doc__
        self._lock = threading.Lock()
        self._kernel: Any = None
        self._compiled: set[tuple[Any, ...]] = set()

    def __call__(self, count: int, *arguments: Any) -> None:
        """Launch on ``count`` sites; the first parameter of the function is ``count``."""
        if count <= 0:
            return
        size = _SIMULATED if simulating() else (min(-(-count // THREADS), _MOST_BLOCKS), THREADS)
        self._launch(*size, (count, *arguments))

    def blocks(self, blocks: tuple[int, ...], threads: tuple[int, ...], *arguments: Any) -> None:
        """Launch blocks of threads of a certain shape."""
        if min(blocks) > 0:
            self._launch(blocks, threads, arguments)

    def _launch(self, blocks: Any, threads: Any, arguments: tuple[Any, ...]) -> None:
        if simulating():
            arguments = tuple(plain(argument) for argument in arguments)
            self._prepare(_types(arguments))
            # one at a time, for the simulator keeps what runs in a global name
            with _SIMULATOR:
                self._kernel[blocks, threads](*arguments)
            return
        if self._kernel is None:
            self._prepare(())
        with ExactProducts():
            self._kernel[blocks, threads, _stream()](*arguments)

    def _prepare(self, types: tuple[Any, ...]) -> None:
        from numba import config, cuda

        with self._lock:
            if self._kernel is None:
                # launches and cupy's calls share a stream, so that nothing has to wait in between
                setattr(config, "CUDA_ARRAY_INTERFACE_SYNC", False)  # noqa: B010
                # small grids are meant: tables of few rows, one block that colours
                setattr(config, "CUDA_LOW_OCCUPANCY_WARNINGS", False)  # noqa: B010
                # Compiled code is kept on disk, as the loops of the CPU are.  Optimised at link time it would be
                # compiled by the linker, which `ExactProducts` does not reach and which fuses products; `jit` hands
                # that option on only where it gets the function in the same call.
                options = {} if simulating() else {"lto": False}
                self._kernel = cuda.jit(self.function, **options)
                if not simulating():
                    keep_grid(self._kernel)
            if types:
                place = (self.function.__module__, self.function.__qualname__)
                LAUNCHED.setdefault(place, set()).add(types)


def grid(function: Callable[..., None]) -> Grid:
    """Make a CUDA kernel of a function that walks sites; nothing of CUDA is needed before its first launch."""
    return Grid(function)


_SIMULATOR = threading.Lock()


def _types(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    typeof: Callable[[Any], Any] = numba.typeof
    return tuple(typeof(argument) for argument in arguments)


_DEFAULT_STREAM = 1
"""Handle of the default stream for those who must name one (CUDA's CU_STREAM_LEGACY): cupy warns of 0."""


def _stream() -> Any:
    return _numba_stream(device_namespace().cuda.get_current_stream().ptr or _DEFAULT_STREAM)


@lru_cache(maxsize=256)
def _numba_stream(pointer: int) -> Any:
    """Stream of cupy as numba takes it: the same object every time, for by it numba keeps how to launch a grid."""
    from numba import cuda

    return cuda.external_stream(pointer)


class ExactProducts:
    """While it is open, products and sums are rounded one by one on the device, as they are on the CPU.

    NVIDIA's compiler fuses ``a * b + c`` by default, which rounds once: results would differ from the CPU's, and with
    them what lies at a threshold.  numba has no option for it, so its call of the compiler gets one here.
    """

    _lock = threading.RLock()
    _depth = 0
    _before: Any = None

    def __enter__(self) -> None:
        from numba.cuda.cudadrv import nvvm

        with self._lock:
            cls = type(self)
            if cls._depth == 0:
                before = cls._before = nvvm.compile_ir
                nvvm.compile_ir = lambda code, **options: before(code, **{**options, "fma": False})
            cls._depth += 1

    def __exit__(self, *_: object) -> None:
        from numba.cuda.cudadrv import nvvm

        with self._lock:
            cls = type(self)
            cls._depth -= 1
            if cls._depth == 0:
                nvvm.compile_ir = cls._before
