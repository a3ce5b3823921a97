"""The order in which a run begins and is published, each step on disk before the next: no loss of power undoes it."""

from __future__ import annotations

from pathlib import Path

from tests.disk_calls import Call, disk_calls
from tilepipe.engine.options import RunOptions
from tilepipe.engine.progress import Silent
from tilepipe.engine.run import open_run
from tilepipe.engine.run_folder import FILES, IDENTITY, Uses, write_log
from tilepipe.io.files.manifest import write_manifest
from tilepipe.io.files.record import PICTURES, RECORD, STATE, TIMINGS

LAYERS = ("map.tif", "lines.parquet")


def published(folder: Path, *, overwrite: bool = False) -> tuple[list[Call], str]:
    """What beginning and publishing a run asks of the disk, and the name of the run's own folder in the state."""
    options, record = RunOptions(workers=1, overwrite=overwrite), {"command": "streets"}
    uses = Uses((), LAYERS)
    with disk_calls(folder) as calls, open_run(folder, record, record, options, Silent(), uses) as run:
        for name in LAYERS:
            (run.state / name).write_text(name)
        run.publish([run.state / name for name in LAYERS], record)
        return calls, str(run.state.relative_to(folder))


def test_each_step_is_on_disk_before_the_next(tmp_path: Path) -> None:
    published(tmp_path)
    write_manifest(tmp_path / PICTURES, [])
    calls, state = published(tmp_path, overwrite=True)
    at = calls.index

    def flushed(first: int, last: int, name: str = ".") -> bool:
        return ("fsync", name) in calls[first + 1 : last]

    # the layers are whole, and what may be replaced is known, before anything goes
    written = len(calls) - 1 - calls[::-1].index(("put", f"{STATE}/{FILES}"))
    assert all(at(("fsync", f"{state}/{name}")) < written for name in LAYERS)
    aside = at(("put", f"{state}/{RECORD}"))
    assert calls[aside - 2] == ("fsync", calls[aside - 1][1]) and aside < written, "the record to come is whole"
    record_gone = at(("gone", RECORD))
    assert written < record_gone and flushed(written, record_gone, STATE)
    # nothing claims the files of the earlier run before they go
    assert flushed(record_gone, min(at(("gone", name)) for name in LAYERS))
    assert at(("gone", PICTURES)) < min(at(("gone", name)) for name in LAYERS)
    # no moment shows layers of two runs
    last_gone, first_put = max(at(("gone", name)) for name in LAYERS), min(at(("put", name)) for name in LAYERS)
    assert flushed(last_gone, first_put)
    assert at(("fsync", f"{state}/{TIMINGS}")) < at(("put", TIMINGS))
    # the record says that all is there when all is there
    record_put = at(("put", RECORD))
    assert flushed(max(at(("put", name)) for name in (*LAYERS, TIMINGS)), record_put)
    # the state goes when the run is finished, its identity first
    identity_gone = at(("gone", f"{STATE}/{IDENTITY}"), record_put)
    assert flushed(record_put, identity_gone)
    rest = [index for index, (kind, name) in enumerate(calls) if index > record_put and kind == "gone"]
    assert rest[0] == identity_gone and flushed(identity_gone, rest[1], STATE)
    assert ("gone", state) in calls[identity_gone:]


def test_what_makes_a_run_resumable_is_on_disk_before_it_works(tmp_path: Path) -> None:
    """Log, record and identity, in this order: an identity says that the rest is there."""
    calls, _ = published(tmp_path)
    written = [index for index, call in enumerate(calls) if call[0] == "put" and call[1].startswith(STATE)]
    first = {name: next(i for i in written if calls[i][1] == f"{STATE}/{name}") for name in (FILES, RECORD, IDENTITY)}
    assert sorted(first, key=lambda name: first[name]) == [FILES, RECORD, IDENTITY]
    for index in first.values():
        part = calls[index - 1][1]
        assert ("fsync", part) in calls[:index] and ("fsync", STATE) in calls[index : index + 2]


def test_a_state_that_is_replaced_loses_its_identity_first(tmp_path: Path) -> None:
    """Without an identity what is left is nobody's; with one it would be resumed."""
    options = RunOptions(workers=1, overwrite=True)
    for number in range(2):
        record = {"command": "streets", "parameters": {"number": number}}
        try:
            with disk_calls(tmp_path) as calls, open_run(tmp_path, record, record, options, Silent()) as run:
                (run.state / "half").write_text("")
                raise KeyboardInterrupt
        except KeyboardInterrupt:
            pass
    gone = [index for index, (kind, name) in enumerate(calls) if kind == "gone" and not name.endswith(".part")]
    state = [index for index in gone if calls[index][1] in (f"{STATE}/{IDENTITY}", f"{STATE}/{RECORD}")]
    assert calls[state[0]] == ("gone", f"{STATE}/{IDENTITY}")
    assert ("fsync", STATE) in calls[state[0] : next(index for index in gone if index > state[0])]


def test_the_log_is_on_disk_when_it_is_written(tmp_path: Path) -> None:
    (tmp_path / STATE).mkdir()
    with disk_calls(tmp_path) as calls:
        write_log(tmp_path, [])
    assert [kind for kind, _ in calls] == ["fsync", "gone", "put", "fsync"]
