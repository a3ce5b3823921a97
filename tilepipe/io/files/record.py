"""The files beside the layers of a run: its record, which says everything as resolved, and its timings."""

from __future__ import annotations

import math
import re
import stat
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path, PurePath
from typing import Any

from tilepipe.errors import InputError

RECORD = "run.toml"
TIMINGS = "timings.json"
PICTURES = "pictures.toml"
"""Record of the pictures that a report has added to a run."""
STATE = ".state"
"""Folder of an unfinished run, in the folder of the run."""

TABLES = ("inputs", "raster", "options", "parameters", "files")
_DEEPEST = 100
"""Most tables and lists within each other: many more than records have, and few enough to walk through by recursion."""

# tomllib takes a time that grows with the square of the parts of a key
_LONG_KEY = re.compile(rf"""(?<![\w'"-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){{{_DEEPEST}}}""")
_TOO_DEEP = "too many tables or brackets within each other"

KNOWN = ("command", "version", "out", "elsewhere", *TABLES)
"""What a record may hold."""


def read_record(path: Path) -> dict[str, Any]:
    """Read a record and check the type of all that tilepipe reads of it; what a pipeline adds is free.

    Parameters
    ----------
    path
        A file; nothing else is opened, so that a pipe or a device cannot make the reader wait.

    Returns
    -------
    dict
        What the file holds, as it was written; anything may be left out.

    Raises
    ------
    InputError
        The file is missing, is no TOML, or holds something of another type than it should; one line that names it.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.record import read_record
    >>> _ = Path("run.toml").write_text("inputs.band = 0")
    >>> read_record(Path("run.toml"))
    Traceback (most recent call last):
        ...
    tilepipe.errors.InputError: run.toml: [inputs] band must be a whole number of at least 1, not 0; correct it
    """
    record = read_toml(path)
    if complaint := _complaint(record):
        raise InputError(f"{path}: {complaint}; correct it")
    return record


def read_toml(path: Path) -> dict[str, Any]:
    """Read a file of TOML of any content; errors as for `read_record`.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.record import read_toml
    >>> _ = Path("some.toml").write_text("seed = 3")
    >>> read_toml(Path("some.toml"))
    {'seed': 3}
    """
    advice = "name the run.toml of a run"
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise InputError(f"{path}: is no file but a folder or device; {advice}")
        content = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; {advice}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); {advice}") from None
    try:
        # some editors begin a file with a mark of its encoding
        return parsed_toml(content.decode("utf-8-sig"))
    # a number of too many digits is a ValueError of its own
    except (MemoryError, ValueError) as error:
        raise InputError(f"{path}: is no valid TOML ({_shortened(str(error))})") from error


def parsed_toml(text: str) -> dict[str, Any]:
    """What a text of TOML holds.

    Raises
    ------
    ValueError
        It is no TOML, or more tables and lists lie within each other than anything has that is written here.

    Examples
    --------
    >>> from tilepipe.io.files.record import parsed_toml
    >>> parsed_toml("inputs.band = 2")
    {'inputs': {'band': 2}}
    """
    if _LONG_KEY.search(text):
        raise ValueError(_TOO_DEEP)
    try:
        found = tomllib.loads(text)
    except RecursionError:
        raise ValueError(_TOO_DEEP) from None
    if _is_deeper(found, _DEEPEST):
        raise ValueError(_TOO_DEEP)
    return found


def _is_deeper(value: Any, levels: int) -> bool:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else None
    return inner is not None and (levels == 0 or any(_is_deeper(item, levels - 1) for item in inner))


def as_toml(record: Mapping[str, Any]) -> bytes:
    """A record as TOML; values that are None are left out and mean the default.

    Examples
    --------
    >>> from tilepipe.io.files.record import as_toml
    >>> as_toml({"command": "streets", "inputs": {"crs": None, "band": 2}}).decode().split()
    ['command', '=', '"streets"', '[inputs]', 'band', '=', '2']
    """
    import tomli_w

    def clean(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: clean(item) for key, item in value.items() if item is not None}
        return value

    return tomli_w.dumps(clean(record)).encode()


def check_record(record: Mapping[str, Any], name: str) -> None:
    """Check a record that comes from no file.

    Raises
    ------
    InputError
        As for `read_record`.

    Examples
    --------
    >>> from tilepipe.io.files.record import check_record
    >>> check_record({"command": 3}, "the record")
    Traceback (most recent call last):
        ...
    tilepipe.errors.InputError: the record: command must be a text, not 3; correct it
    """
    if complaint := _complaint(record):
        raise InputError(f"{name}: {complaint}; correct it")


Check = Callable[[Any], bool]


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_whole(least: int, most: int = (1 << 31) - 1) -> Check:
    """Check of a whole number; by default at most what GDAL can count rows, columns and bands with."""
    return lambda value: isinstance(value, int) and not isinstance(value, bool) and least <= value <= most


def _is_number(value: Any) -> bool:
    try:
        return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:
        return False


def _is_length(value: Any) -> bool:
    return _is_number(value) and value > 0


def _are_texts(value: Any) -> bool:
    return _is_text(value) or (isinstance(value, list) and all(map(_is_text, value)))


def _is_pair(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_is_whole(1), value))


def _is_written(value: Any) -> bool:
    return isinstance(value, dict) and all(_is_whole(0, 1 << 62)(value.get(key)) for key in ("size", "crc32"))


_TEXT = _is_text, "a text"
_PAIR = _is_pair, "two whole numbers of at least 1"
_NUMBER = _is_number, "a finite number"
_LENGTH = _is_length, "a finite number above 0"
_PATHS = _are_texts, "a path or a list of paths"
_ENTRY = _is_written, "a table with size and crc32"
_ANY = (lambda _: True), ""

_SCHEMA: dict[str, tuple[dict[str, tuple[Check, str]], tuple[Check, str]]] = {
    "inputs": ({"crs": _TEXT, "band": (_is_whole(1), "a whole number of at least 1")}, _PATHS),
    "raster": (
        {"shape": _PAIR, "tile": _PAIR, "crs": _TEXT, "left": _NUMBER, "top": _NUMBER}
        | {"pixel": _LENGTH, "metres": _LENGTH, "height_metres": _LENGTH},
        _ANY,
    ),
    "options": ({"executor": _TEXT, "backend": _TEXT, "format": _TEXT}, _ANY),
    "parameters": ({}, _ANY),
    "files": ({}, _ENTRY),
}
"""What a table's entries must be: some by their names, and all others."""


def _complaint(record: Mapping[str, Any]) -> str:
    """What is wrong with a record; empty where nothing is."""
    for name in ("command", "version", "out"):
        if name in record and not _is_text(record[name]):
            return f"{name} must be a text, not {_shown(record[name])}"
    for table, (entries, others) in _SCHEMA.items():
        content = record.get(table, {})
        if not isinstance(content, Mapping):
            return f"'{table}' is no table: write [{table}]"
        for name, value in content.items():
            # each further input has a band of its own
            check, wanted = entries.get("band" if name.endswith("_band") else name, others)
            # None stands for what a record leaves out
            if value is not None and not check(value):
                return f"[{table}] {_shortened(name)} must be {wanted}, not {_shown(value)}"
    for name in record.get("files", {}):
        if name in ("", "..") or PurePath(name).name != name or "\\" in name:
            return f"[files] {_shown(name)} is no name of a file in the folder of the run"
    return "a text holds the character NUL" if _holds_nul(record) else ""


def _holds_nul(value: Any) -> bool:
    if isinstance(value, str):
        return "\0" in value
    if isinstance(value, Mapping):
        return any(_holds_nul(item) for pair in value.items() for item in pair)
    return isinstance(value, list) and any(map(_holds_nul, value))


def _shown(value: Any) -> str:
    try:
        return _shortened(repr(value))
    except ValueError:
        return "a number of too many digits"


def _shortened(text: str) -> str:
    """A text as a part of one line."""
    line = " ".join(text.split())
    return line if len(line) <= 60 else f"{line[:57]}…"
