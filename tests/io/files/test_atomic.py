"""A file appears under its name when it is whole, or not at all."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from tests.disk_calls import disk_calls
from tilepipe.errors import InputError
from tilepipe.io.files import atomic
from tilepipe.io.files.atomic import atomic_write
from tilepipe.io.files.durable import atomic_write_bytes


def test_a_failing_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("old")

    def fail(error: type[BaseException]) -> None:
        with atomic_write(path) as aside:
            aside.write_text("half")
            raise error

    for error in (RuntimeError, KeyboardInterrupt):
        with pytest.raises(error):
            fail(error)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_an_interruption_while_it_tidies_up_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    remove = shutil.rmtree

    def interrupted(*arguments: object, **named: object) -> None:
        monkeypatch.setattr(shutil, "rmtree", remove)
        raise KeyboardInterrupt

    monkeypatch.setattr(shutil, "rmtree", interrupted)
    with pytest.raises(KeyboardInterrupt), atomic_write(tmp_path / "a.txt") as aside:
        aside.write_text("whole")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_what_others_take_for_a_leftover_is_left_to_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It may lock a new folder before the one who made it, and remove it at any time."""
    locked, taken = atomic._locked, list[tuple[Path, int | None]]()

    def locked_late(folder: Path) -> int | None:
        if not taken:
            taken.append((folder, locked(folder)))
        return locked(folder)

    monkeypatch.setattr(atomic, "_locked", locked_late)
    with atomic_write(tmp_path / "a.txt") as aside:
        folder, lock = taken[0]
        assert lock is not None
        shutil.rmtree(folder)
        os.close(lock)
        aside.write_text("whole")
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_leftovers_of_a_killed_write_are_cleared(tmp_path: Path) -> None:
    with atomic_write(tmp_path / "a.txt") as aside:
        left = aside.parent
        aside.write_text("x")
    left.mkdir()
    (left / "a.txt-journal").write_text("half")
    with atomic_write(tmp_path / "a.txt") as aside:
        assert list(aside.parent.iterdir()) == []
        aside.write_text("new")
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_an_error_of_another_file_keeps_its_name(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="other"), atomic_write(tmp_path / "a.txt"):
        (tmp_path / "elsewhere" / "other.txt").read_text()


def test_bytes_that_cannot_be_written_leave_nothing(tmp_path: Path) -> None:
    with pytest.raises(TypeError):
        atomic_write_bytes(tmp_path / "file", "no bytes")  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []


def test_nothing_of_others_is_cleared(tmp_path: Path) -> None:
    """Neither a folder of a like name, nor what a link points to, nor what a living writer holds."""
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "diary.txt").write_text("mine")
    (tmp_path / ".a.txt.partial").mkdir()
    (tmp_path / ".a.txt.partial" / "diary.txt").write_text("mine")
    (tmp_path / ".tilepipe-0123456789abcdef.partial").symlink_to(mine)
    (tmp_path / ".tilepipe-fedcba9876543210.partial").write_text("mine")
    with atomic_write(tmp_path / "b.txt") as other:
        other.write_text("half")
        with atomic_write(tmp_path / "a.txt") as aside:
            aside.write_text("new")
        assert other.read_text() == "half"
    found = {str(path.relative_to(tmp_path)): path.read_text() for path in tmp_path.rglob("*.txt")}
    assert found == {
        "a.txt": "new",
        "b.txt": "half",
        "mine/diary.txt": "mine",
        ".a.txt.partial/diary.txt": "mine",
    }
    assert (tmp_path / ".tilepipe-0123456789abcdef.partial").is_symlink()
    assert (tmp_path / ".tilepipe-fedcba9876543210.partial").read_text() == "mine"


def test_only_files_are_replaced(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name in ("folder", "pipe"):
        with pytest.raises(InputError, match="it is no file but a folder or device"), atomic_write(tmp_path / name):
            pass
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "pipe"]


def test_a_folder_that_is_gone_stays_gone(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        atomic_write_bytes(tmp_path / "gone" / "file", b"late")
    assert list(tmp_path.iterdir()) == []


def test_what_a_loss_of_power_could_undo_is_on_disk_before_the_next_step(tmp_path: Path) -> None:
    with disk_calls(tmp_path) as calls:
        with atomic_write(tmp_path / "a.txt") as aside:
            aside.write_text("whole")
        hidden = str(aside.relative_to(tmp_path))
        assert calls[:4] == [("fsync", hidden), ("gone", hidden), ("put", "a.txt"), ("fsync", ".")]
        calls.clear()
        atomic_write_bytes(tmp_path / "b.txt", b"whole", durable=True)
        (_, part), *others = calls
        assert part.startswith(".b.txt.") and calls[0] == ("fsync", part)
        assert others == [("gone", part), ("put", "b.txt"), ("fsync", ".")]
        calls.clear()
        atomic_write_bytes(tmp_path / "c.txt", b"whole")
        assert [kind for kind, _ in calls] == ["gone", "put"], "the many files of tiles do not wait"
