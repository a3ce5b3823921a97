"""Fingerprints of modules: a hash of all source text that what is compiled in a module can depend on.

A loop holds the rules and constants that it uses, and these come from its own file or are imported.  So the text of a
module and of all that it imports, directly or by way of others, decides what its loops compute.  Imports are read from
the text and not from what happens to be loaded, so that every process finds the same.  Installed libraries are taken as
fixed, but for the packages that hold rules themselves.

A text says what is compiled only if Python runs that text: not where the file has changed since the process started,
and not where Python has taken its own compiled file for that of another text of the same size and second.
"""

from __future__ import annotations

import hashlib
import importlib.util
import marshal
import os
import re
import sys
import time
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple


def _start_of_process() -> float:
    """When this process started, for the first modules are loaded long before this one."""
    try:
        with open("/proc/self/stat") as file:
            ticks = int(file.read().rpartition(")")[2].split()[19])
        # a tick is begun, and nothing is loaded in the first: what was written just before the start is not of later
        since_boot = (ticks + 1) / os.sysconf("SC_CLK_TCK")
        return time.time() - time.clock_gettime(time.CLOCK_BOOTTIME) + since_boot
    except (OSError, ValueError, AttributeError):
        return time.time()


_START = _start_of_process()
_BY_TIME, _CHECKED_BY_HASH = 0, 3
"""Kinds of Python's own compiled files (PEP 552)."""

_WITH_RULES = {"tilepipe", "tilepipe_kernels"}

_INVISIBLE = re.compile(r"#[^\n]*|\\\n")
_IMPORT = re.compile(
    r"(?:^|[;:])[ \t]*(?:from[ \t]+([.\w]+)[ \t]+import[ \t]*(\([^)]*\)|[^\n;]*)|import[ \t]+([^\n;]*))", re.MULTILINE
)
_NAME = re.compile(r"(?:^|[,(])\s*([\w.]+)")


class _Source(NamedTuple):
    """What is read of a file: a hash of its text, its imports, and whether it makes names when they are asked for."""

    digest: str
    imports: tuple[tuple[str, tuple[str, ...]], ...]
    makes_names: bool


def has_rules(module: str) -> None:
    """Follow imports of the package that a module stands in, for it holds rules or loops."""
    _WITH_RULES.add(module.partition(".")[0])


@cache
def fingerprint(module: str, file: str) -> str | None:
    """Hash of the sources that the compiled functions of a module depend on.

    Parameters
    ----------
    module
        Its full name.
    file
        Its path.

    Returns
    -------
    str or None
        The same for the same sources, wherever they lie.  None where they are not known: the module is no file (a
        cell of a notebook, say), a file has changed since this process started, perhaps after it was imported, or
        Python has loaded something else than the text.
    """
    sources = {module: file}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        for imported in _imported(name, sources[name]):
            path = sources.get(imported) or _file_of(imported)
            if path and imported not in sources:
                sources[imported] = path
                waiting.append(imported)
    digest = hashlib.sha256()
    for name, path in sorted(sources.items()):
        # the time of the last change cannot be set back, as that of the last modification can
        if not os.path.isfile(path) or os.stat(path).st_ctime > _START or not _is_loaded_as_written(path):
            return None
        digest.update(f"{name} {_read(path).digest}\n".encode())
    return digest.hexdigest()


@cache
def _is_loaded_as_written(path: str) -> bool:
    """Whether what Python loads of a file is its text: Python goes by the second of the last change and the size."""
    try:
        kept = importlib.util.cache_from_source(path)
        written = os.stat(kept).st_mtime_ns
        with open(kept, "rb") as file:
            header, code = file.read(16), file.read()
    except (OSError, NotImplementedError):
        return True
    source = os.stat(path)
    kind, second, size = (int.from_bytes(header[i : i + 4], "little") for i in (4, 8, 12))
    if header[:4] != importlib.util.MAGIC_NUMBER or kind == _CHECKED_BY_HASH:
        return True
    if kind == _BY_TIME:
        of_text = (second, size) == (int(source.st_mtime) & 0xFFFFFFFF, source.st_size & 0xFFFFFFFF)
        if not of_text or written > source.st_ctime_ns:
            return True
    with open(path, "rb") as file:
        text = file.read()
    try:
        return bool(marshal.loads(code) == compile(text, path, "exec", dont_inherit=True))
    except (ValueError, EOFError, TypeError, SyntaxError):
        return False


def _imported(module: str, path: str) -> Iterator[str]:
    """Names that may be modules and that the text of a module imports."""
    if not os.path.isfile(path):
        return
    package = module if os.path.basename(path) == "__init__.py" else module.rpartition(".")[0]
    for origin, names in _read(path).imports:
        base = origin.lstrip(".")
        if dots := len(origin) - len(base):
            parents = package.split(".")[: len(package.split(".")) + 1 - dots]
            base = ".".join([*parents, base] if base else parents)
        yield base
        for name in names:
            yield f"{base}.{name}"
        yield from _behind(base, names)


def _behind(package: str, names: tuple[str, ...]) -> Iterator[str]:
    """Modules of a package that gives out names of them only when they are asked for; which, its text does not say."""
    path = _file_of(package)
    if not path or os.path.basename(path) != "__init__.py" or not _read(path).makes_names:
        return
    if all(_file_of(f"{package}.{name}") for name in names):
        return
    folder = os.path.dirname(path)
    for place, _, files in os.walk(folder):
        parents = [package, *os.path.relpath(place, folder).split(os.sep)]
        for file in files:
            if file.endswith(".py"):
                yield ".".join(part for part in [*parents, file[:-3]] if part not in (".", "__init__"))


@cache
def _file_of(module: str) -> str | None:
    """Path of a module whose package is followed; None for others and for what is no module."""
    top, *parts = module.split(".")
    loaded = sys.modules.get(top)
    file = getattr(loaded, "__file__", None)
    folders = list(getattr(loaded, "__path__", ()))
    if top not in _WITH_RULES and (top in sys.stdlib_module_names or _installed(folders[0] if folders else file)):
        return None
    if not parts and file:
        return str(file)
    for folder in folders:
        path = os.path.join(folder, *parts)
        for candidate in (f"{path}.py", os.path.join(path, "__init__.py")):
            if os.path.isfile(candidate):
                return candidate
    return None


def _installed(path: str | None) -> bool:
    return path is None or "site-packages" in path or "dist-packages" in path


@cache
def _read(path: str) -> _Source:
    with open(path, "rb") as file:
        content = file.read()
    text = _INVISIBLE.sub("", content.decode("utf-8", "replace"))
    imports = []
    for origin, names, modules in _IMPORT.findall(text):
        if origin:
            imports.append((origin, tuple(_NAME.findall(names))))
        imports.extend((module, ()) for module in _NAME.findall(modules))
    return _Source(hashlib.sha256(content).hexdigest(), tuple(imports), "def __getattr__" in text)
