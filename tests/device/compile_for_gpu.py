"""Compile every grid that the simulated tests have launched for a real GPU, with the very types of those launches.

The simulator runs Python and checks no types; the compiler does, and needs no GPU::

    TILEPIPE_LAUNCHED=folder python -m pytest tests/device
    python -m tests.device.compile_for_gpu folder

It needs numba-cuda with NVIDIA's compiler, as wheels (the extra ``gpu-compile``).
"""

from __future__ import annotations

import importlib
import os
import pickle
import re
import sys
import time
from pathlib import Path
from typing import Any

COMPUTE_CAPABILITY = (8, 0)
"""Of the oldest GPU that results are promised for (A100); newer ones run its code too."""

_FUSED = re.compile(r"\bfma\.rn\.f(32|64)")


def keep(folder: Path) -> None:
    """Write the types of all launches of this process into a folder, one file for each process."""
    from tilepipe_kernels.core.compiled import LAUNCHED

    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"launched-{os.getpid()}.pickle").write_bytes(pickle.dumps(LAUNCHED))


def kept(folder: Path) -> dict[tuple[str, str], set[tuple[Any, ...]]]:
    """The types of all launches of all processes."""
    found: dict[tuple[str, str], set[tuple[Any, ...]]] = {}
    for path in sorted(folder.glob("launched-*.pickle")):
        for place, types in pickle.loads(path.read_bytes()).items():
            found.setdefault(place, set()).update(types)
    return found


def fused_if_allowed(values: Any) -> None:
    """A product and a sum that the compiler would fuse."""
    values[0] = values[1] * values[2] + values[3]


def compile_all(folder: Path) -> list[str]:
    """Compile all; what failed, in words."""
    from numba import cuda, types
    from numba.cuda import dispatcher

    from tilepipe_kernels.core.compiled import ExactProducts, grid

    class Device:
        compute_capability = COMPUTE_CAPABILITY

    # rules that a kernel calls are compiled for the current device, and there is none
    dispatcher.get_current_device = lambda: Device
    failed, count, start = [], 0, time.perf_counter()
    with ExactProducts():
        code, _ = cuda.compile(
            fused_if_allowed, types.void(types.float32[::1]), cc=COMPUTE_CAPABILITY, device=False, abi="numba",
            output="ptx",
        )  # fmt: skip
    if _FUSED.search(str(code)):
        failed.append("compiled.ExactProducts no longer keeps products and sums apart: results will not be the CPU's")
    probe = grid(fused_if_allowed)
    probe._prepare(())
    if probe._kernel.targetoptions.get("lto"):
        failed.append("grids are linked by nvJitLink, which fuses products whatever the compiler was told")
    for (module, name), launches in sorted(kept(folder).items()):
        function = getattr(importlib.import_module(module), name).function
        for argument_types in sorted(launches, key=str):
            count += 1
            try:
                with ExactProducts():
                    code, _ = cuda.compile(
                        function, types.void(*argument_types), cc=COMPUTE_CAPABILITY, device=False, abi="numba",
                        output="ptx",
                    )  # fmt: skip
            except Exception as error:
                failed.append(f"{module}.{name}{argument_types}: {type(error).__name__}: {error}")
                continue
            if _FUSED.search(code if isinstance(code, str) else code.decode()):
                # a division or a root in 64 bits is made of fused steps, and is rounded as on the CPU for all that
                print(f"note: {module}.{name} has fused products")
    print(f"{count} grids compiled for compute capability {COMPUTE_CAPABILITY} in {time.perf_counter() - start:.0f} s")
    return failed if count else ["no launches were kept: run the tests in tests/device with TILEPIPE_LAUNCHED first"]


if __name__ == "__main__":
    problems = compile_all(Path(sys.argv[1]))
    print(*problems, sep="\n")
    sys.exit(bool(problems))
