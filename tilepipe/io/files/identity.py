"""Whether a file is still the one that a run began with: its size, its time of change and samples of its content.

The samples tell files apart that have the same size and time, as a copy that keeps its time has, and are the same on
every machine.  What they cannot tell is a change of a large file between the samples that keeps size and time.  That is
told by the time at which the system itself last touched the file's entry, which nobody can set; machines may see it
differently, so it counts in the process that has asked for it, and in the record of a run as a reason to read again.
"""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from tilepipe.errors import InputError
from tilepipe.io.files.paths import SIDE, file_of, is_remote
from tilepipe.io.files.remote import remote_state
from tilepipe.tiling.grid import Window

_SAMPLES, _SAMPLE = 8, 8 << 10
"""Pieces of a file that are read, evenly spaced from its first byte to its last, and their length in bytes."""

_SECOND = 1_000_000_000

_seen: dict[str, tuple[tuple[int, ...], FileState]] = {}
"""What this process found each file to be, and by which entry of the file system."""


class ChangedInputError(InputError):
    """A file is no longer what a run began with; nothing that was computed since may be used."""


@dataclass(frozen=True)
class FileState:
    """What a file is: its size in bytes (-1 where there is none), its time of change in ns, a digest of its content.

    ``touched`` is the time in ns at which the system last changed its entry, 0 where that is not known.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.identity import file_state
    >>> _ = Path("a.bin").write_bytes(b"one")
    >>> first = file_state("a.bin")
    >>> _ = Path("a.bin").write_bytes(b"two")
    >>> first.has_content_of(file_state("a.bin")), first.size
    (False, 3)
    """

    size: int
    modified: int
    digest: str
    touched: int = 0

    def __reduce__(self) -> tuple[type[FileState], tuple[int, int, str]]:
        # another machine may see the entry differently
        return FileState, (self.size, self.modified, self.digest)

    def has_content_of(self, other: FileState) -> bool:
        """Whether size and samples are those of another; they may still differ between the samples."""
        return (self.size, self.digest) == (other.size, other.digest)

    def is_same(self, other: FileState) -> bool:
        """Whether this is the same file: of the same content as far as sampled, and not written to since."""
        # of a small file the samples are all
        whole = self.size <= _SAMPLES * _SAMPLE
        touched = self.touched and other.touched and self.touched != other.touched
        return self.has_content_of(other) and (whole or (_same_time(self.modified, other.modified) and not touched))

    @property
    def is_unknown(self) -> bool:
        """Whether nobody can tell, as of files on some servers."""
        return self == UNKNOWN

    @property
    def is_nothing(self) -> bool:
        """Whether there is no such file, or nothing in it that counts."""
        return self in (MISSING, EMPTY)

    def text(self) -> str:
        """Size, times and digest, for the record of an unfinished run."""
        return f"{self.size} {self.modified}/{self.touched} {self.digest or '-'}"


MISSING = FileState(-1, 0, "")
EMPTY = FileState(-2, 0, "")
"""State of a side file that decides nothing, or is not there."""
UNKNOWN = FileState(0, 0, "")


def _same_time(a: int, b: int) -> bool:
    """Whether one time of change may look like these two where one file system keeps less of it than the other."""
    # the coarsest in use keep even seconds; others keep tenths of a microsecond
    one_is_coarse = (a % _SECOND == 0) != (b % _SECOND == 0)
    return abs(a - b) < (2 * _SECOND if one_is_coarse else 1000)


def file_state(name: str) -> FileState:
    """What a file is now, by the name under which GDAL opens it.

    Raises
    ------
    OSError
        When it is there but cannot be read.
    """
    if is_remote(name):
        return FileState(*remote_state(name))
    path = file_of(name)
    if path is None:
        return UNKNOWN
    if path.endswith(SIDE):
        digest = _pam_digest(path)
        return FileState(0, 0, digest) if digest else EMPTY
    try:
        entry = _entry(path)
        if path not in _seen or _seen[path][0] != entry:
            _seen[path] = entry, FileState(entry[0], entry[1], _digest(path, entry[0]), entry[2])
    except FileNotFoundError:
        return MISSING
    return _seen[path][1]


def digest_of(text: str) -> str:
    """Digest of a text: 16 hexadecimal digits."""
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def _entry(path: str) -> tuple[int, ...]:
    """What the file system says of a file; cheap to ask for."""
    status = os.stat(path)
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino, status.st_dev


def _digest(path: str, size: int) -> str:
    """Digest of samples of a file; of all of it where it is not longer than they are."""
    digest = hashlib.blake2b(digest_size=8)
    with open(path, "rb", buffering=0) as file:
        if size <= _SAMPLES * _SAMPLE:
            digest.update(file.read())
        else:
            for index in range(_SAMPLES):
                file.seek((size - _SAMPLE) * index // (_SAMPLES - 1))
                digest.update(file.read(_SAMPLE))
    return digest.hexdigest()


def _pam_digest(path: str) -> str:
    """Digest of what decides values in GDAL's side file; statistics and histograms, which viewers add, do not."""
    try:
        root = ElementTree.parse(path).getroot()
    except (FileNotFoundError, ElementTree.ParseError):
        return ""
    _drop_statistics(root)
    return hashlib.blake2b(ElementTree.tostring(root), digest_size=8).hexdigest() if len(root) else ""


def _drop_statistics(element: ElementTree.Element) -> None:
    for child in list(element):
        child.tail = None
        if child.tag == "Histograms" or child.get("key", "").startswith("STATISTICS_"):
            element.remove(child)
            continue
        had_children = len(child) > 0
        _drop_statistics(child)
        if (had_children and not len(child)) or (child.tag == "Metadata" and not len(child)):
            element.remove(child)
    if len(element):
        element.text = None


@dataclass(frozen=True)
class Files:
    """The files that a raster is read from, as they were when it was opened.

    Attributes
    ----------
    name
        Of the raster, for messages.
    files
        Name, state and the part of the raster's pixels that a file holds (None = all, or unknown).
    """

    name: str
    files: tuple[tuple[str, FileState, Window | None], ...]

    @property
    def lines(self) -> list[str]:
        """Size, time, digest and name of each file, for the record of an unfinished run."""
        return [f"{state.text()} {name}" for name, state, _ in self.files if not state.is_nothing]

    @property
    def stamp(self) -> str:
        """Digest of all that is known of the files."""
        return digest_of("\n".join(self.lines))

    @property
    def content(self) -> str:
        """Digest of the sizes and the content of the files, whenever they were written."""
        known = "\n".join(f"{state.size} {state.digest} {name}" for name, state, _ in self.files)
        return digest_of(known)

    @property
    def paths(self) -> tuple[Path, ...]:
        """Those on this machine, the archives of members among them."""
        found = (file_of(name) for name, state, _ in self.files if not state.is_nothing)
        return tuple(dict.fromkeys(Path(path) for path in found if path is not None))

    @property
    def is_known(self) -> bool:
        """Whether the state of every file can be asked for; of some servers it cannot."""
        return not any(state.is_unknown for _, state, _ in self.files)

    def check(self, window: Window | None = None) -> None:
        """Compare the files behind a window of the raster, or all, with what they were.

        Raises
        ------
        ChangedInputError
            Names the file.
        """
        for name, then, part in self.files:
            if window is None or part is None or not part.intersection(window).is_empty:
                self._check_file(name, then)

    def _check_file(self, name: str, then: FileState) -> None:
        whose = self.name if name == self.files[0][0] else f"{self.name}: its {name}"
        try:
            now = file_state(name)
        except OSError as error:
            raise ChangedInputError(f"{whose}: cannot be read any more ({error.strerror or error}); {_AGAIN}") from None
        if now.is_same(then) or now.is_unknown or then.is_unknown:
            return
        if now == MISSING:
            raise ChangedInputError(f"{whose}: is gone since the run began; {_AGAIN}")
        raise changed(whose, written=now.has_content_of(then))


_AGAIN = "nothing is published; put it back and run the same command again"


def changed(name: str, *, written: bool) -> ChangedInputError:
    """The error for an input that is not what a run began with, or perhaps was only written again as it was."""
    if written:
        remedy = "run the same command again, which goes on if all that was read is still the same"
        return ChangedInputError(f"{name}: has been written to since the run began; nothing is published; {remedy}")
    remedy = "when nothing writes to it any more, start anew with --overwrite"
    return ChangedInputError(f"{name}: has changed since the run began; nothing is published; {remedy}")


def files_of(name: str, names: list[tuple[str, Window | None]]) -> Files:
    """Files of a raster in their present state, with the side files that GDAL may find beside each.

    Parameters
    ----------
    name
        Of the raster.
    names
        Names under which GDAL opens them, and the part of the pixels that each holds.

    Raises
    ------
    OSError
        When a file cannot be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.identity import files_of
    >>> _ = Path("a.tif").write_bytes(b"pixels")
    >>> files = files_of("a.tif", [("a.tif", None)])
    >>> files.check()
    >>> Path("a.tif").unlink()
    >>> files.check()
    Traceback (most recent call last):
        ...
    tilepipe.io.files.identity.ChangedInputError: a.tif: is gone since the run began; nothing is published; ...
    """
    found: dict[tuple[str, Window | None], FileState] = {}
    for each, part in names:
        beside = [f"{each}.msk", f"{each}{SIDE}"] if file_of(each) == each else []
        for file in (each, *beside):
            found.setdefault((file, part), file_state(file))
    return Files(name, tuple((file, state, part) for (file, part), state in found.items()))
