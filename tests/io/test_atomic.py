"""A file appears under its name when it is whole, or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest

from tilepipe.io.atomic import atomic_write, atomic_write_bytes


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
