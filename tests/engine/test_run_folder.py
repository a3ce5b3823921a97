"""The folder of a run: foreign files stay, one process works in it at a time, no kill leaves it broken."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from tests.laws import Killed
from tilepipe.engine import publication, run_lock
from tilepipe.engine.options import RunOptions
from tilepipe.engine.progress import Silent
from tilepipe.engine.run import Run, open_run
from tilepipe.engine.run_folder import Uses, is_unfinished, status
from tilepipe.engine.run_lock import MARK, OWNER
from tilepipe.engine.tiles.executors import SerialExecutor
from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.tiles.passes import BoundPass, run_pass
from tilepipe.engine.tiles.state import StateArray, write_state
from tilepipe.errors import InputError, TileError
from tilepipe.io.files.record import RECORD, STATE, TIMINGS, read_record
from tilepipe.tiling.facts import Facts
from tilepipe.tiling.grid import Tile, TileGrid

NAMES = ("map.tif", "lines.parquet", "lines.gpkg")


@contextmanager
def opened(folder: Path, identity: str, *, overwrite: bool = False, inputs: tuple[Path, ...] = ()) -> Iterator[Run]:
    options = RunOptions(workers=1, overwrite=overwrite)
    record, uses = {"command": "streets", "parameters": {"name": identity}}, Uses(inputs, NAMES)
    with open_run(folder, record, {"name": identity}, options, Silent(), uses) as run:
        yield run


def made(
    folder: Path,
    identity: str = "a",
    names: tuple[str, ...] = NAMES[:2],
    *,
    overwrite: bool = False,
    inputs: tuple[Path, ...] = (),
) -> Path:
    """A run whose layers hold its identity."""
    with opened(folder, identity, overwrite=overwrite, inputs=inputs) as run:
        for name in names:
            (run.state / name).write_text(f"{identity} {name}")
        run.publish([run.state / name for name in names], {"command": "streets", "parameters": {"name": identity}})
    return folder


def begun(folder: Path, identity: str = "a", work: Callable[[Run], object] = lambda _: None) -> None:
    """A run that does some work and ends before it publishes."""

    def end() -> None:
        with opened(folder, identity) as run:
            work(run)
            raise Killed

    with pytest.raises(Killed):
        end()


def refused(message: str, folder: Path, work: Callable[[Run], object]) -> None:
    """A run whose work is refused."""

    def try_it() -> None:
        with opened(folder, "a") as run:
            work(run)

    with pytest.raises(InputError, match=message):
        try_it()


def contents(folder: Path) -> dict[str, str]:
    """All files below a folder but for the records."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name not in (RECORD, TIMINGS))
    return {str(path.relative_to(folder)): path.read_text() for path in files}


def layers(identity: str, names: tuple[str, ...] = NAMES[:2]) -> dict[str, str]:
    return {name: f"{identity} {name}" for name in names}


# --- nothing foreign is harmed


def own(folder: Path) -> None:
    (folder / STATE).mkdir(parents=True)
    (folder / STATE / "diary.txt").write_text("mine")


def with_lock(folder: Path) -> None:
    own(folder)
    (folder / STATE / "lock").write_text("of my bicycle")


def linked(folder: Path) -> None:
    own(folder.parent / "elsewhere")
    folder.mkdir()
    (folder / STATE).symlink_to(folder.parent / "elsewhere" / STATE)


def linked_lock(folder: Path) -> None:
    (folder.parent / "key").write_text("mine")
    (folder / STATE).mkdir(parents=True)
    (folder / STATE / "lock").symlink_to(folder.parent / "key")


def a_file(folder: Path) -> None:
    folder.mkdir()
    (folder / STATE).write_text("mine")


def with_a_pipe(folder: Path) -> None:
    begun(folder)
    os.mkfifo(folder / STATE / OWNER)


@pytest.mark.parametrize("foreign", [own, with_lock, linked, linked_lock, a_file, with_a_pipe])
@pytest.mark.parametrize("overwrite", [False, True])
def test_a_state_folder_of_others_is_refused(tmp_path: Path, foreign: Callable[[Path], None], overwrite: bool) -> None:
    foreign(tmp_path / "run")
    before = contents(tmp_path)
    with pytest.raises(InputError, match=r"\.state: was not made by tilepipe"):
        made(tmp_path / "run", overwrite=overwrite)
    assert contents(tmp_path) == before


def test_files_of_others_in_a_state_folder_stay(tmp_path: Path) -> None:
    begun(tmp_path / "run")
    (tmp_path / "run" / STATE / "notes.txt").write_text("mine")
    made(tmp_path / "run", "b", overwrite=True)
    assert contents(tmp_path / "run") == layers("b") | {f"{STATE}/notes.txt": "mine"}
    assert status(tmp_path / "run")["state"] == "finished"


@pytest.mark.parametrize("name", ["map.tif", "lines.gpkg", "anything.txt"])
def test_a_folder_with_files_of_others_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / name).write_text("mine")
    for overwrite in (False, True):
        with pytest.raises(InputError, match="is not empty and holds no run"):
            made(tmp_path / "run", overwrite=overwrite)
    assert contents(tmp_path / "run") == {name: "mine"}


@pytest.mark.parametrize("name", ["map.tif", "lines.gpkg", TIMINGS])
def test_overwriting_replaces_only_what_was_published(tmp_path: Path, name: str) -> None:
    """Neither a file that was edited nor one that has the name of another layer."""
    run = made(tmp_path / "run")
    (run / "notes.txt").write_text("mine")
    (run / name).write_text("mine")
    before = contents(run)
    with pytest.raises(InputError, match=f"{name}: was not written by tilepipe or has changed since"):
        made(run, "b", overwrite=True)
    assert contents(run) == before
    assert read_record(run / RECORD)["parameters"] == {"name": "a"}
    (run / name).unlink()
    made(run, "b", overwrite=True)
    assert contents(run) == layers("b") | {"notes.txt": "mine"}


def test_a_record_that_is_a_link_is_not_replaced(tmp_path: Path) -> None:
    run = made(tmp_path / "run")
    (run / RECORD).rename(tmp_path / "record.toml")
    (run / RECORD).symlink_to(tmp_path / "record.toml")
    for overwrite in (False, True):
        with pytest.raises(InputError, match=r"run\.toml: is not the record of a finished run"):
            made(run, "b", overwrite=overwrite)
    assert (run / RECORD).is_symlink()


def test_a_file_that_appears_during_the_run_is_not_replaced(tmp_path: Path) -> None:
    def publish(run: Run) -> None:
        (run.folder / "map.tif").write_text("mine")
        (run.state / "map.tif").write_text("new")
        run.publish([run.state / "map.tif"], {"command": "streets"})

    refused(r"map\.tif: was not written", tmp_path / "run", publish)
    assert (tmp_path / "run" / "map.tif").read_text() == "mine"
    # what has been computed is kept until it is moved away
    assert is_unfinished(tmp_path / "run")
    (tmp_path / "run" / "map.tif").unlink()
    assert contents(made(tmp_path / "run")) == layers("a")


def test_overwriting_removes_all_layers_of_the_earlier_run(tmp_path: Path) -> None:
    run = made(tmp_path / "run", names=(*NAMES, "of_another_pipeline.tif"))
    made(run, "b", NAMES[:1], overwrite=True)
    assert contents(run) == layers("b", NAMES[:1])


@pytest.mark.parametrize("text", ["out = 'run'\ncommand = 'streets'", "name = 'of another program'", "no toml ="])
def test_a_record_of_others_is_no_finished_run(tmp_path: Path, text: str) -> None:
    (tmp_path / RECORD).write_text(text)
    (tmp_path / "map.tif").write_text("mine")
    for overwrite in (False, True):
        with pytest.raises(InputError, match=r"run\.toml"):
            made(tmp_path, overwrite=overwrite)
    assert (tmp_path / RECORD).read_text() == text
    assert contents(tmp_path) == {"map.tif": "mine"}


def test_an_input_is_not_replaced(tmp_path: Path) -> None:
    run = made(tmp_path / "run")
    (tmp_path / "soft.tif").symlink_to(run / "map.tif")
    os.link(run / "map.tif", tmp_path / "hard.tif")
    (tmp_path / "folder").symlink_to(run)
    for path in (run / "map.tif", tmp_path / "soft.tif", tmp_path / "hard.tif", tmp_path / "folder" / "map.tif"):
        with pytest.raises(InputError, match="is an input, and lies where the run would write"):
            made(run, "b", overwrite=True, inputs=(path,))
    assert contents(run) == layers("a")
    (tmp_path / "store.zarr").mkdir()
    with pytest.raises(InputError, match="lies within the input"):
        made(tmp_path / "store.zarr" / "run", inputs=(tmp_path / "store.zarr",))
    assert not list((tmp_path / "store.zarr").iterdir())


def test_a_refusal_leaves_no_folder(tmp_path: Path) -> None:
    def fail(run: Run) -> None:
        raise InputError("no luck")

    refused("no luck", tmp_path / "new" / "run", fail)
    assert not list(tmp_path.iterdir())


# --- one process at a time, on whatever machine


def test_two_processes_of_one_machine(tmp_path: Path) -> None:
    with opened(tmp_path / "run", "a"):
        for identity in ("a", "b"):
            with pytest.raises(InputError, match="another process is at work"):
                made(tmp_path / "run", identity, overwrite=True)
    made(tmp_path / "run")


@pytest.mark.parametrize("alive", [True, False])
def test_a_process_of_another_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, alive: bool) -> None:
    """Its lock is not seen here; what it writes is."""
    begun(tmp_path / "run")
    owner = tmp_path / "run" / STATE / OWNER
    name = json.dumps({"host": "far", "boot": "other", "pid": 7, "token": "x"})
    owner.write_text(name)
    monkeypatch.setattr(run_lock, "_PATIENCE", 3 if alive else 0)
    beats = iter(range(9))
    monkeypatch.setattr(run_lock.time, "sleep", lambda _: owner.write_text(f"{name}\n{next(beats)}" if alive else name))
    lives = pytest.raises(InputError, match=r"another process is at work in it \(process 7 of far\)")
    waits = pytest.warns(UserWarning, match="process 7 of far was at work in it; waiting")
    with waits, lives if alive else nullcontext():
        made(tmp_path / "run")
    assert is_unfinished(tmp_path / "run") == alive


def test_who_was_taken_for_dead_does_not_publish(tmp_path: Path) -> None:
    def publish(run: Run) -> None:
        (run.folder / STATE / OWNER).write_text("{}")
        run.publish([], {})

    refused("another process has taken it over", tmp_path / "run", publish)
    assert not (tmp_path / "run" / RECORD).exists()


def published_late(folder: Path, step: int) -> None:
    """A run publishes, and before the given rename of it another process takes the folder over and does so too."""
    rename, left = os.replace, [step]

    def rename_late(source: Path, target: Path) -> None:
        left[0] -= 1
        if not left[0]:
            with (
                patch.object(os, "replace", rename),
                patch.object(run_lock, "_lock", lambda *_: False),
                patch.object(run_lock, "_PATIENCE", 0),
                pytest.warns(UserWarning, match="was at work in it"),
            ):
                made(folder, "b", overwrite=True)
        rename(source, target)

    with opened(folder, "c", overwrite=True) as run:
        for name in NAMES[1:]:
            (run.state / name).write_text(f"c {name}")
        with patch.object(os, "replace", rename_late):
            run.publish([run.state / name for name in NAMES[1:]], {"command": "streets"})


def test_who_was_taken_for_dead_while_it_published_touches_nothing_more(tmp_path: Path) -> None:
    renames = 10
    for step in range(1, renames + 1):
        folder = made(tmp_path / str(step))
        with pytest.raises(InputError, match="another process has taken it over"):
            published_late(folder, step)
        assert contents(folder) == layers("b"), step
        assert not (folder / STATE).exists()
    published_late(made(tmp_path / "all"), renames + 1)


def test_who_was_taken_for_dead_while_it_tidied_up_leaves_the_lock(tmp_path: Path) -> None:
    folder, remove = tmp_path / "run", shutil.rmtree
    owner = folder / STATE / OWNER

    def remove_slowly(path: Path) -> None:
        remove(path)
        owner.write_text("of another")

    with patch.object(shutil, "rmtree", remove_slowly):
        made(folder)
    assert contents(folder) == layers("a") | {f"{STATE}/{OWNER}": "of another", f"{STATE}/lock": MARK.decode()}


def test_who_was_taken_for_dead_removes_no_state(tmp_path: Path) -> None:
    def refuse(run: Run) -> None:
        (run.folder / STATE / OWNER).write_text("{}")
        raise InputError("of no use")

    refused("of no use", tmp_path / "run", refuse)
    assert is_unfinished(tmp_path / "run")


def test_a_link_to_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run").symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match="is a link to a folder that is not there"):
        made(tmp_path / "run")


# --- a dead run does not write into a living one

GRID = TileGrid((8, 8), (4, 4))


def fill(context: tuple[StateArray, int], tile: Tile) -> Facts:
    array, value = context
    return write_state({"a": array}, tile, {"a": np.full(tile.core.shape, value)})


def bound(state: Path, value: int) -> BoundPass:
    array = StateArray(state / "a.zarr", GRID, "int32")
    return BoundPass("fill", fill, (array, value), GRID, 0, {"a": array})


def test_a_worker_that_outlives_its_driver_writes_nowhere(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    states: list[Path] = []

    def work(run: Run) -> None:
        states.append(run.state)
        run.run_pass(bound(run.state, 1))

    begun(folder, work=work)
    old = states[0]
    left = bound(old, 1)
    with opened(folder, "b", overwrite=True) as run:
        assert run.state != old
        for tile in GRID.tiles():
            with pytest.raises(FileNotFoundError):
                fill(left.context, tile)
            with pytest.raises(FileNotFoundError):
                Ledger(old / "fill").record(tile.name, {})
        ledger = run.run_pass(bound(run.state, 2))
        assert {int(array.sum()) for facts in ledger.each() for array in facts.values()} != {0}
        assert bound(run.state, 2).context[0].read(GRID.tile(0).core.padded(9, GRID.shape)).tolist() == [[2] * 8] * 8
        assert not old.exists()
        run.publish([], {"command": "streets"})
    with pytest.raises(FileNotFoundError):
        Ledger(old / "fill").record("r0000c0000", {})
    with pytest.raises(FileNotFoundError):
        left.context[0].write(GRID.tile(0), np.zeros((4, 4), np.int32))
    assert not (folder / STATE).exists()


def test_a_chunk_makes_no_folder_of_a_state_anew_even_if_it_goes_while_the_chunk_is_written(tmp_path: Path) -> None:
    (tmp_path / "token").mkdir()
    array = StateArray(tmp_path / "token" / "a.zarr", GRID, "int32")
    array.create()
    make = os.mkdir

    def make_late(path: str, *arguments: int, **named: int) -> None:
        shutil.rmtree(tmp_path / "token", ignore_errors=True)
        make(path, *arguments, **named)

    with patch.object(os, "mkdir", make_late), pytest.raises(FileNotFoundError, match="another run has begun"):
        array.write(GRID.tile(0), np.ones((4, 4), np.int32))
    assert not (tmp_path / "token").exists()
    with pytest.raises(FileNotFoundError, match="another run has begun"):
        array.create()
    assert not (tmp_path / "token").exists()


def test_the_same_run_is_resumed_under_its_token(tmp_path: Path) -> None:
    states: list[Path] = []
    for _ in range(2):
        begun(tmp_path / "run", work=lambda run: states.append(run.state))
    assert states[0] == states[1]


# --- done means done


class Liar(SerialExecutor):
    """Says that all tiles are done, of which it computes some."""

    def run(self, function, items):  # type: ignore[no-untyped-def]
        yield from super().run(function, items[:-1])
        yield items[-1], items[-1].number, None


def test_a_tile_without_facts_is_not_done(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from tilepipe.engine.tiles import passes

    monkeypatch.setattr(passes, "_NEWS", 0)
    with pytest.raises(TileError, match=r"tile r0001c0001 .* failed: FileNotFoundError: its facts cannot be seen here"):
        run_pass(bound(tmp_path, 1), tmp_path, Liar(), Silent())
    run_pass(bound(tmp_path, 1), tmp_path, SerialExecutor(), Silent())


@pytest.mark.parametrize("damage", [b"", b"{}", b"\0" * 99, None])
def test_a_damaged_array_is_made_anew(tmp_path: Path, damage: bytes | None) -> None:
    run_pass(bound(tmp_path, 1), tmp_path, SerialExecutor(), Silent())
    description = tmp_path / "a.zarr" / "zarr.json"
    if damage is None:
        shutil.rmtree(tmp_path / "a.zarr")
        StateArray(tmp_path / "a.zarr", TileGrid((8, 8), (2, 8)), "int16").create()
    else:
        description.write_bytes(damage)
    run_pass(bound(tmp_path, 1), tmp_path, SerialExecutor(), Silent())
    assert bound(tmp_path, 1).context[0].read(GRID.tile(0).core.padded(9, GRID.shape)).tolist() == [[1] * 8] * 8


STEPS = ("unlink", "replace", "rename", "rmtree", "rmdir", "fsync", "mkdir")


def killed_at(step: int) -> Iterator[list[int]]:
    """Ends the process, so to say, before the given change of the file system."""
    count = [0]

    def counting(function: Callable[..., object]) -> Callable[..., object]:
        def change(*arguments: object, **options: object) -> object:
            count[0] += 1
            if count[0] >= step:
                raise Killed
            return function(*arguments, **options)

        return change

    with patch.multiple(os, **{name: counting(getattr(os, name)) for name in STEPS if hasattr(os, name)}):
        yield count


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_kill_at_any_step_of_a_publication_is_recovered_from(tmp_path: Path, overwrite: bool) -> None:
    """No record claims a mixture, and the same or another command brings the folder in order."""
    names, step, ended = NAMES[::2], 0, False
    while not ended:
        step += 1
        for after in ("same", "other"):
            folder = tmp_path / f"{step}{after}"
            if overwrite:
                made(folder, "old")
            try:
                with opened(folder, "new", overwrite=overwrite) as run:
                    for name in names:
                        (run.state / name).write_text(f"new {name}")
                    with contextmanager(killed_at)(step):
                        run.publish([run.state / name for name in names], {"command": "streets"})
                ended = True
            except Killed:
                pass
            # a dead process removes nothing more
            found = {name: text for name, text in contents(folder).items() if not name.startswith(STATE)}
            if (folder / RECORD).exists():
                assert found in (layers("new", names), layers("old"))
            if after == "same" and is_unfinished(folder):
                made(folder, "new", names)
            elif after == "same":
                with pytest.raises(InputError, match="holds a finished run"):
                    made(folder, "new", names)
            else:
                made(folder, "other", overwrite=True)
            expected = layers("new", names) if after == "same" else layers("other")
            assert contents(folder) == expected, step
            assert not (folder / STATE).exists()
    assert step > 10


def test_publication_is_on_disk_step_by_step(tmp_path: Path) -> None:
    """Layers before their names, names before the record, the record before the state goes."""
    events: list[str] = []

    def noting(name: str, function: Callable[..., object]) -> Callable[..., object]:
        def change(*arguments: object, **options: object) -> object:
            events.append(f"{name} {Path(str(arguments[-1])).name}")
            return function(*arguments, **options)

        return change

    with opened(tmp_path / "run", "a") as run:
        (run.state / "map.tif").write_text("new")
        with (
            patch.object(publication, "flush_to_disk", noting("flush", publication.flush_to_disk)),
            patch.object(publication, "flush_folder", noting("flush", publication.flush_folder)),
            patch.object(publication.os, "replace", noting("rename", os.replace)),
            patch.object(publication, "remove_state", lambda folder, _: events.append(f"remove state {folder.name}")),
        ):
            run.publish([run.state / "map.tif"], {"command": "streets"})
    order = [event for event in events if not event.endswith((".toml", TIMINGS)) or event == f"rename {RECORD}"]
    assert order[0] == "flush map.tif"
    assert order[-5:] == ["rename map.tif", "flush run", f"rename {RECORD}", "flush run", "remove state run"]


def test_another_run_is_finished_first_or_given_up(tmp_path: Path) -> None:
    begun(tmp_path / "run", "a", lambda run: (run.state / "map.tif").write_text("half"))
    with pytest.raises(InputError) as told:
        made(tmp_path / "run", "b")
    record = tmp_path / "run" / STATE / RECORD
    assert str(told.value) == (
        f"{tmp_path / 'run'}: holds an unfinished run that differs in name; finish it with 'tilepipe run {record}', "
        "or start anew with --overwrite"
    )
    assert read_record(record)["parameters"] == {"name": "a"}
    with opened(tmp_path / "run", "b", overwrite=True) as run:
        assert not (run.state / "map.tif").exists()
    assert contents(made(tmp_path / "run", "b", overwrite=True)) == layers("b")
