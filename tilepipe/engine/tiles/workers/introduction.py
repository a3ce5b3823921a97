"""Whether a worker may compute tiles: it has the code and the libraries of the driver, and sees its folder.

What is here runs on the worker and on the driver, and the driver compares.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import platform
import sys
import time
import uuid
from collections.abc import Mapping
from functools import cache
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path

_LIBRARIES = (
    "numpy", "scipy", "numba", "llvmlite", "scikit-image", "rasterio", "pyproj", "shapely", "pyarrow", "zarr",
    "distributed", "dask",
)  # fmt: skip
"""What the bytes of a tile, or their way here, can depend on."""

_PACKAGES = ("tilepipe", "tilepipe_kernels")

_START = time.time()

_NEWS = 5.0
"""Seconds in which a new file of a network file system appears on other machines (actimeo of nfs(5): 3 s at least)."""


@cache
def code_here() -> dict[str, str]:
    """Versions of all that a tile's result can depend on, and a hash of tilepipe's sources.

    Examples
    --------
    >>> from tilepipe.engine.tiles.workers.introduction import code_here
    >>> list(code_here())[:3]
    ['tilepipe', 'sources of tilepipe', 'Python']
    """
    import rasterio

    found = {"tilepipe": _version("tilepipe"), "sources of tilepipe": _sources(), "Python": platform.python_version()}
    # of Python the patch release changes nothing
    found["Python"] = found["Python"].rpartition(".")[0]
    found |= {name: _version(name) for name in _LIBRARIES}
    found["GDAL"] = str(rasterio.__gdal_version__)
    found["byte order"] = sys.byteorder
    return found


def _version(name: str) -> str:
    loaded = getattr(sys.modules.get(name), "__version__", None)
    try:
        return str(loaded or metadata.version(name))
    except metadata.PackageNotFoundError:
        return "missing"


def _sources() -> str:
    """Hash of the text of tilepipe and its kernels, as far as this process can have loaded it."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        spec = find_spec(package)
        for folder in spec.submodule_search_locations or () if spec else ():
            for path in sorted(Path(folder).rglob("*.py")):
                # the time of the last change cannot be set back
                if path.stat().st_ctime > _START:
                    return "changed while it was running"
                digest.update(f"{package} {path.relative_to(folder)} ".encode() + path.read_bytes())
    return digest.hexdigest()[:12]


async def introduce(folder: str, token: str) -> tuple[dict[str, str], str]:
    """What a worker tells about itself: its code, and what is wrong with its sight of a folder; it runs there.

    Parameters
    ----------
    folder
        Folder of the driver; empty where none is needed.
    token
        Name of a file in it.
    """
    # beside the worker's own loop, which is to go on with its signs of life
    return await asyncio.to_thread(_introduction, folder, token)


def _introduction(folder: str, token: str) -> tuple[dict[str, str], str]:
    # a task is read in that loop: what its function needs is loaded before
    import_module("tilepipe.engine.tiles.passes")
    return code_here(), _what_is_wrong(Path(folder), token) if folder else ""


def _what_is_wrong(folder: Path, token: str) -> str:
    deadline = time.monotonic() + _NEWS
    while not (folder / token).exists():
        if time.monotonic() > deadline:
            return f"does not see {folder} of the machine where the command runs"
        time.sleep(0.2)
    try:
        mine = folder / f".{uuid.uuid4().hex}.part"
        mine.touch()
        mine.unlink()
    except OSError as error:
        return f"cannot write into {folder} ({os.strerror(error.errno or 0)})"
    return ""


def objection(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """In what a worker's code differs from the driver's; empty when it is the same.

    Examples
    --------
    >>> from tilepipe.engine.tiles.workers.introduction import objection
    >>> objection({"numpy": "2.1.0", "GDAL": "3.9"}, {"numpy": "2.0.1", "GDAL": "3.9"})
    'differs in numpy (2.0.1, here 2.1.0)'
    """
    names = [name for name in here if here[name] != there.get(name)]
    told = ", ".join(f"{name} ({there.get(name, 'missing')}, here {here[name]})" for name in names)
    return f"differs in {told}" if told else ""
