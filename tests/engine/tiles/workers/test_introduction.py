"""What a worker tells of itself: its code, and whether it sees and may write the folder of the run."""

from __future__ import annotations

import asyncio
import errno
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from tilepipe.engine.tiles.workers import introduction
from tilepipe.engine.tiles.workers.introduction import code_here, introduce, objection


def told(folder: Path | None) -> str:
    code, wrong = asyncio.run(introduce("" if folder is None else str(folder), "token"))
    assert code == code_here() and objection(code_here(), code) == ""
    return wrong


def test_a_folder_that_is_shared(tmp_path):
    (tmp_path / "token").touch()
    assert told(tmp_path) == told(None) == ""
    assert [path.name for path in tmp_path.iterdir()] == ["token"]


@pytest.mark.parametrize("late", [False, True])
def test_a_token_may_take_a_while_to_be_seen(tmp_path, monkeypatch, late):
    moments = [0.0]

    def sleep(seconds: float) -> None:
        moments[0] += seconds
        if moments[0] >= introduction._NEWS + (1 if late else -1):
            (tmp_path / "token").touch()

    monkeypatch.setattr(introduction, "time", SimpleNamespace(monotonic=lambda: moments[0], sleep=sleep))
    assert told(tmp_path) == (f"does not see {tmp_path} of the machine where the command runs" if late else "")


def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch):
    (tmp_path / "token").touch()

    def touch(path: Path) -> None:
        raise OSError(errno.EROFS, "read-only")

    monkeypatch.setattr(Path, "touch", touch)
    assert told(tmp_path) == f"cannot write into {tmp_path} ({os.strerror(errno.EROFS)})"


def test_sources_that_change_while_they_run_are_told(monkeypatch):
    assert introduction._sources() == code_here()["sources of tilepipe"] != ""
    monkeypatch.setattr(introduction, "_START", 0.0)
    assert introduction._sources() == "changed while it was running"


def test_a_library_that_is_not_there_is_missing():
    assert introduction._version("no_such_library") == "missing"
