"""The end of a run: its layers appear in its folder together, then its record says that they are whole.

The order outlasts a kill and a loss of power at any moment; each step is on disk before the next begins.

1. The new layers are whole in the state; `files.toml` there names them, the earlier run's files and the record to come.
2. The earlier record goes: nothing claims the files any more.  Then the earlier files go, and the new ones are renamed.
3. The record appears: the run is finished.  Then the state goes.

Until the record appears the same command resumes the run and publishes again; it knows by `files.toml` which files it
may replace.  After that, what is left of the state is nobody's, and the next command removes it.

Whatever comes to the run's folder or goes from it is renamed out of or into the folder of the token: a process that was
taken for dead has none any more, and so cannot harm the run that has taken its place, at whatever step it wakes.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tilepipe.engine.run_folder import known_files, remove_state, write_log
from tilepipe.engine.run_lock import RunLock
from tilepipe.io.files.durable import atomic_write_bytes, flush_folder, flush_to_disk
from tilepipe.io.files.manifest import Written, as_table, refuse_foreign
from tilepipe.io.files.record import PICTURES, RECORD, TIMINGS, as_toml


def publish(
    folder: Path,
    state: Path,
    layers: Sequence[Path],
    record: Mapping[str, Any],
    timings: Mapping[str, float],
    lock: RunLock,
) -> None:
    """Put the layers of a run in the place of those of an earlier one, and mark it as finished.

    Parameters
    ----------
    folder, state
        Of the run.
    layers
        Finished files in the state; they keep their names.
    record
        What was run.
    timings
        Seconds of each stage.
    lock
        Of the folder, held.

    Raises
    ------
    OutputError
        A file that would be replaced or removed is none of tilepipe, or has been changed, and nothing has been touched;
        or another process has taken the folder over, at whatever step, and is left alone from there on.
    """
    lock.require()
    rounded = {name: round(seconds, 3) for name, seconds in timings.items()}
    (state / TIMINGS).write_bytes(json.dumps(rounded, indent=1).encode())
    published = [*layers, state / TIMINGS]
    for file in published:
        flush_to_disk(file)
    new, old = [Written.of(file) for file in published], known_files(folder)
    refuse_foreign(folder, [file.name for file in (*old, *new)], (*old, *new))
    aside = state / RECORD
    atomic_write_bytes(aside, as_toml({**record, "files": as_table(new)}), durable=True)
    write_log(folder, dict.fromkeys((*old, *new, Written.of(aside))))

    for name in (RECORD, PICTURES):
        lock.require()
        _withdraw(folder / name, state)
    flush_folder(folder)
    for name in {file.name for file in old}:
        lock.require()
        _withdraw(folder / name, state)
    # no moment shows layers of two runs
    flush_folder(folder)
    for file in published:
        lock.require()
        os.replace(file, folder / file.name)
    flush_folder(folder)

    lock.require()
    os.replace(aside, folder / RECORD)
    flush_folder(folder)
    remove_state(folder, lock)


def _withdraw(file: Path, state: Path) -> None:
    """Move a file of an earlier run into the state, with which it goes.

    Raises
    ------
    FileNotFoundError
        The state is gone.
    """
    if file.is_symlink() or file.exists():
        os.replace(file, state / f"{file.name}.earlier")
