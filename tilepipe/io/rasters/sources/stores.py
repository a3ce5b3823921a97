"""Whether a Zarr store is still the one that a run began with, by the entries of its many files.

Opening every file of a store would take longer than a tile, so content is sampled from a few; all count with their
size and time.  Of a window only the chunks that hold it are looked at.
"""

from __future__ import annotations

import hashlib
import itertools
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from tilepipe.errors import InputError
from tilepipe.io.files.identity import FileState, changed, digest_of, file_state
from tilepipe.tiling.grid import Window

Axis = Literal["y", "-y", "x", "all"]
"""What a dimension of a stored array is: rows, rows from the south, columns, or one that is read as a whole."""

_SAMPLES = 8
"""Chunks whose content is sampled, evenly spaced among all."""

Entries = dict[str, tuple[int, int, int, int]]
"""Size, time of change, time of change of the entry, and number of each file, by its name within the store."""

_seen: dict[str, Entries] = {}
"""The entries with which this process has found a store to be as it was."""


@dataclass(frozen=True)
class StoreFiles:
    """The files of a Zarr store as they were when it was opened.

    Attributes
    ----------
    name
        Of the store, for messages.
    path
        Of its folder.
    variable
        The raster in it.
    axes
        What its dimensions are, in their order in the store.
    state
        Sizes, times and samples of all files together.
    touched
        Digest of the times at which the system last changed their entries, which nobody can set; empty where that is
        not known, as in another process.
    """

    name: str
    path: str
    variable: str
    axes: tuple[Axis, ...]
    state: tuple[int, str, str]
    touched: str = ""

    is_known = True

    def __reduce__(self) -> tuple[Any, ...]:
        # another machine may see the entries differently
        return StoreFiles, (self.name, self.path, self.variable, self.axes, self.state)

    @property
    def lines(self) -> list[str]:
        """Size, digests of the times, digest of the content and name, for the record of an unfinished run."""
        size, times, digest = self.state
        return [f"{size} {times}/{self.touched} {digest} {self.path}"]

    @property
    def content(self) -> str:
        """Digest of sizes and samples, whenever the files were written."""
        return digest_of(f"{self.path}\n{self.state[2]}")

    @property
    def stamp(self) -> str:
        """Digest of all that is known of the files."""
        return self.state[1] + self.touched + self.state[2]

    def check(self, window: Window | None = None) -> None:
        """Compare the chunks behind a window, or all files, with what they were.

        Raises
        ------
        ChangedInputError
            Names the store.
        """
        known = _seen.get(self.path)
        if window is not None and known is not None and self._are_as(known, window):
            return
        now, touched, entries = _state(self.path)
        if now == self.state and self.touched in ("", touched):
            _seen[self.path] = entries
            return
        raise changed(self.name, written=now[2] == self.state[2])

    def _are_as(self, known: Entries, window: Window) -> bool:
        return all(known.get(name) == _entry(os.path.join(self.path, name)) for name in self._chunks(window))

    def _chunks(self, window: Window) -> Iterator[str]:
        """Names of the files of the chunks that a window touches."""
        import zarr

        array = zarr.open_array(os.path.join(self.path, self.variable), mode="r")
        ranges = []
        for axis, size, step in zip(self.axes, array.shape, array.shards or array.chunks, strict=True):
            first, end = {
                "y": (window.top, window.bottom),
                "-y": (size - window.bottom, size - window.top),
                "x": (window.left, window.right),
                "all": (0, size),
            }[axis]
            ranges.append(range(first // step, -(-end // step)))
        for place in itertools.product(*ranges):
            yield os.path.join(self.variable, *array.metadata.encode_chunk_key(place).split("/"))


def store_files(path: Path, name: str, variable: str, axes: Sequence[Axis]) -> StoreFiles:
    """Files of a store in their present state.

    Raises
    ------
    InputError
        When a file cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> import zarr
    >>> from tilepipe.io.rasters.sources.stores import store_files
    >>> _ = zarr.create_array("a.zarr/height", shape=(4, 6), chunks=(2, 6), dtype="uint8")
    >>> files = store_files(Path("a.zarr"), "a.zarr", "height", ["y", "x"])
    >>> files.check()
    """
    folder = os.path.abspath(path)
    try:
        state, touched, _seen[folder] = _state(folder)
    except OSError as error:
        raise InputError(f"{name}: {error.filename} cannot be read ({error.strerror})") from error
    return StoreFiles(name, folder, variable, tuple(axes), state, touched)


def _entry(path: str) -> tuple[int, int, int, int] | None:
    try:
        status = os.stat(path)
    except FileNotFoundError:
        return None
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino


def _state(folder: str) -> tuple[tuple[int, str, str], str, Entries]:
    """Size, digest of times, digest of names, sizes and samples; digest of the times of entries; the entries."""
    entries: Entries = {}
    for place, _, names in os.walk(folder):
        for name in names:
            path = os.path.join(place, name)
            entry = _entry(path)
            if entry is not None:
                entries[os.path.relpath(path, folder)] = entry
    times, touched, content = (hashlib.blake2b(digest_size=8) for _ in range(3))
    names = sorted(entries)
    # of what describes the arrays all is read, of the chunks a few
    described = [name for name in names if os.path.basename(name).startswith((".z", "zarr.json"))]
    chunks = sorted(set(names) - set(described))
    sampled = {*described, *(chunks[len(chunks) * index // _SAMPLES] for index in range(_SAMPLES) if chunks)}
    for name in names:
        size, modified, changed_entry, _ = entries[name]
        touched.update(f"{name} {changed_entry}\n".encode())
        times.update(f"{name} {modified}\n".encode())
        found: FileState | None = file_state(os.path.join(folder, name)) if name in sampled else None
        content.update(f"{name} {size} {found.digest if found else ''}\n".encode())
    size = sum(entry[0] for entry in entries.values())
    return (size, times.hexdigest(), content.hexdigest()), touched.hexdigest(), entries
