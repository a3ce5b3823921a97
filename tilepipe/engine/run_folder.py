"""The folder of a run: whose it is, what of it may be replaced, and the state of a run that is not finished.

::

    RUN/run.toml           the record: the run is finished, these are its parameters and its files
    RUN/.state/            an unfinished run, or what is left of a finished one
        lock  owner        the mark of tilepipe; who is at work
        identity.toml      what decides the state, and its token; without it a state is nobody's
        run.toml           the record that resumes the run
        files.toml         files in RUN that tilepipe has written: those of an earlier run, and those being published
        <token>/           ledgers, arrays and layers

The token is made when a state begins.  All that workers write lies below it, and they make no folder above what they
write: a worker that has outlived its driver finds its folder gone as soon as another run has begun.  Where the same run
is resumed it writes the same bytes.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import tomllib
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tilepipe.engine.run_lock import LOCK, OWNER, RunLock, held, is_marked
from tilepipe.engine.unchanged import INPUT_FILES, changed_input
from tilepipe.errors import InputError
from tilepipe.io.files.atomic import is_aside
from tilepipe.io.files.durable import atomic_write_bytes, flush_folder
from tilepipe.io.files.manifest import Written, from_table, read_manifest, refuse_foreign
from tilepipe.io.files.record import PICTURES, RECORD, STATE, TIMINGS, as_toml, check_record, read_record, read_toml
from tilepipe.io.rasters.sources.source import Source

IDENTITY = "identity.toml"
FILES = "files.toml"

Record = dict[str, Any]

_TOKEN = re.compile(r"[0-9a-f]{32}")
_LEFTOVER = re.compile(r"[0-9a-f]{32}(\.gone)?|owner\.[0-9a-f]{16}\.stale|\..*\.[0-9a-f]{16}\.part")
"""Names that ended processes leave in a state folder."""


@dataclass(frozen=True)
class Uses:
    """What a run reads and writes, so that it harms neither its inputs nor what is not its own.

    Attributes
    ----------
    inputs
        Files and folders that it reads.
    files
        Names of files that it may publish.
    """

    inputs: tuple[Path, ...] = ()
    files: tuple[str, ...] = ()


def check_folder(folder: Path, uses: Uses, *, overwrite: bool) -> None:
    """Refuse a folder that a run may not touch; nothing is changed.

    Raises
    ------
    InputError
        It is a file, holds a finished run and is not to be overwritten, holds files of others, or an input would be
        replaced.
    """
    if folder.is_symlink() and not folder.exists():
        raise InputError(f"{folder}: is a link to a folder that is not there; make that folder or name another one")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is a file; name a folder for the run")
    state = folder / STATE
    if state.is_symlink() or (state.exists() and not state.is_dir()) or (state.is_dir() and not is_marked(state)):
        raise InputError(f"{state}: was not made by tilepipe; move it or name another folder")
    known = known_files(folder)
    if not is_unfinished(folder):
        if _lies(folder / RECORD):
            if not is_finished(folder):
                raise InputError(f"{folder / RECORD}: is not the record of a finished run; name another folder")
            if not overwrite:
                raise InputError(f"{folder}: holds a finished run; use --overwrite to replace it, or another --out")
        elif folder.exists():
            own = {STATE} | {file.name for file in known} | ({PICTURES} if known else set())
            if any(item.name not in own and not is_aside(item.name) for item in folder.iterdir()):
                raise InputError(f"{folder}: is not empty and holds no run; name another folder")
    replaced = [*(file.name for file in known), *uses.files, TIMINGS]
    _refuse_inputs(folder, uses.inputs, [*replaced, RECORD])
    refuse_foreign(folder, replaced, known)


def _refuse_inputs(folder: Path, inputs: Iterable[Path], replaced: Iterable[str]) -> None:
    """Refuse inputs that the run would replace, and a folder within an input."""
    inside = folder.resolve()
    targets = [path for name in dict.fromkeys(replaced) if (path := folder / name).exists()]
    for path in inputs:
        with suppress(OSError):
            found = path.resolve()
            if found.is_relative_to(inside / STATE) or any(path.samefile(target) for target in targets):
                raise InputError(f"{path}: is an input, and lies where the run would write; name another folder")
            if found.is_dir() and inside.is_relative_to(found):
                raise InputError(f"{folder}: lies within the input {path}; name another folder")


def _lies(path: Path) -> bool:
    return path.is_symlink() or path.exists()


def known_files(folder: Path) -> list[Written]:
    """Files in the folder of a run that tilepipe has written there, by its records; not all of them need be there."""
    files = read_manifest(folder / PICTURES)
    if (folder / RECORD).is_file():
        files += from_table(read_record(folder / RECORD).get("files", {}))
    files += _logged_files(folder)
    return [file for file in dict.fromkeys(files) if file.name != RECORD]


def _logged_files(folder: Path) -> list[Written]:
    """Files that `write_log` has noted; none where a loss of power has left something else."""
    log, files = folder / STATE / FILES, list[Written]()
    if log.is_file() and is_marked(folder / STATE):
        with suppress(InputError):
            entries = read_toml(log).get("files", [])
            for entry in entries if isinstance(entries, list) else []:
                check_record({"files": entry}, str(log))
                files += from_table(entry)
    return files


def is_finished(folder: Path) -> bool:
    """Whether a folder holds the record of a finished run; a link is another file."""
    path = folder / RECORD
    if path.is_symlink() or not path.is_file():
        return False
    record = read_record(path)
    return "command" in record and "files" in record


def is_unfinished(folder: Path) -> bool:
    """Whether a folder holds a run that is not finished; not one whose record has appeared."""
    return read_identity(folder / STATE) is not None and not _is_published(folder)


def _is_published(folder: Path) -> bool:
    return any(file.lies_in(folder) for file in _logged_files(folder) if file.name == RECORD)


def read_identity(state: Path) -> tuple[str, Record] | None:
    """Token and identity of an unfinished run; None where there is none, or none that can be read."""
    try:
        found = read_toml(state / IDENTITY)
    except InputError:
        return None
    token, identity = found.get("token"), found.get("identity")
    if not isinstance(token, str) or not _TOKEN.fullmatch(token) or not isinstance(identity, dict):
        return None
    return (token, identity) if is_marked(state) and (state / token).is_dir() else None


def begin(
    folder: Path, record: Record, identity: Record, sources: Sequence[Source] = (), *, overwrite: bool
) -> tuple[Path, bool]:
    """Resume the state that has this identity, or begin an empty one; the caller holds the lock.

    ``sources`` are the inputs: finished tiles are used only if these are still what they have read.

    Returns
    -------
    tuple
        Folder of the state below its token, and whether it was begun anew.

    Raises
    ------
    InputError
        Another run is unfinished there and is not to be overwritten.
    """
    state = folder / STATE
    found = read_identity(state)
    if found is not None:
        token, earlier = found
        # whether the files are the same is more than a comparison of texts
        now = tomllib.loads(as_toml(identity).decode()) | {INPUT_FILES: earlier.get(INPUT_FILES)}
        differences = _differences(now, earlier)
        changed = None if differences else changed_input(earlier.get(INPUT_FILES, []), sources, state / token)
        if not differences and changed is None:
            # they may have been written again as they were
            write_identity(state, token, identity)
            _clear(state, keep=(RECORD, IDENTITY, FILES, token))
            return state / token, False
        if changed is not None and not overwrite:
            raise InputError(f"{folder}: holds an unfinished run, but {changed}; start anew with --overwrite")
        if not overwrite:
            raise InputError(
                f"{folder}: holds an unfinished run that differs in {', '.join(differences)}; "
                f"finish it with 'tilepipe run {state / RECORD}', or start anew with --overwrite"
            )
    # what may be replaced must be known after the record that says so is gone
    write_log(folder, known_files(folder))
    _clear(state, keep=(FILES,))
    token = secrets.token_hex(16)
    (state / token).mkdir()
    atomic_write_bytes(state / RECORD, as_toml(record), durable=True)
    write_identity(state, token, identity)
    return state / token, True


def write_identity(state: Path, token: str, identity: Record) -> None:
    """Note whose a state is."""
    atomic_write_bytes(state / IDENTITY, as_toml({"token": token, "identity": identity}), durable=True)


def write_log(folder: Path, files: Iterable[Written]) -> None:
    """Note the files that may lie in a run's folder; a name may have several contents."""
    entries = [{file.name: {"size": file.size, "crc32": file.crc32}} for file in files]
    atomic_write_bytes(folder / STATE / FILES, as_toml({"files": entries}), durable=True)


def remove_state(folder: Path, lock: RunLock) -> None:
    """Remove the state of a run while its lock is held; files of others in it stay."""
    state = folder / STATE
    if lock.still_held():
        _clear(state, keep=())
    # a large state takes long to remove, and meanwhile another process may have begun
    if lock.still_held():
        for name in (OWNER, LOCK):
            (state / name).unlink(missing_ok=True)
        with suppress(OSError):
            state.rmdir()


def sweep_finished(folder: Path) -> None:
    """Remove what a killed process has left of the state of a finished run."""
    state = folder / STATE
    if state.is_dir() and not state.is_symlink() and is_marked(state) and _lies(folder / RECORD):
        if is_unfinished(folder) or not is_finished(folder):
            return
        with held(folder, state) as lock:
            if not is_unfinished(folder):
                remove_state(folder, lock)


def _clear(state: Path, keep: Iterable[str]) -> None:
    """Remove what tilepipe has made in a state folder, the identity first: without it the rest is nobody's."""
    own = {RECORD, IDENTITY, FILES} - set(keep)
    if IDENTITY in own and _lies(state / IDENTITY):
        (state / IDENTITY).unlink()
        flush_folder(state)
    for item in list(state.iterdir()):
        if item.name in keep or not (item.name in own or _LEFTOVER.fullmatch(item.name)):
            continue
        if item.is_dir() and not item.is_symlink():
            # what still writes there loses its way at once
            gone = item if item.name.endswith(".gone") else item.with_name(f"{item.name}.gone")
            # who was taken for dead may be removing it as well
            with suppress(FileNotFoundError):
                os.rename(item, gone)
                shutil.rmtree(gone)
        else:
            item.unlink(missing_ok=True)


def _differences(a: Record, b: Record, prefix: str = "") -> list[str]:
    """Dotted names of the entries in which two records differ."""
    names: list[str] = []
    for key in sorted(set(a) | set(b)):
        left, right = a.get(key), b.get(key)
        if isinstance(left, dict) and isinstance(right, dict):
            names += _differences(left, right, f"{prefix}{key}.")
        elif left != right:
            names.append(prefix + key)
    return names


def status(folder: Path) -> dict[str, Any]:
    """What a run folder holds: ``state`` is ``finished``, ``unfinished`` or ``empty``, with the tiles done per pass.

    Raises
    ------
    InputError
        When the folder does not exist.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; name the --out folder of a run")
    state = folder / STATE
    found = read_identity(state)
    if found is not None and is_unfinished(folder):
        passes = {
            item.name: sum(1 for file in item.iterdir() if file.suffix == ".facts" and not file.name.startswith("."))
            for item in sorted((state / found[0]).iterdir(), key=lambda item: item.stat().st_ctime_ns)
            if item.is_dir() and any(item.glob("*.facts"))
        }
        return {"state": "unfinished", "record": read_record(state / RECORD), "passes": passes}
    if (folder / RECORD).exists():
        return {"state": "finished", "record": read_record(folder / RECORD), "passes": {}}
    return {"state": "empty", "record": {}, "passes": {}}
