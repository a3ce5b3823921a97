"""Which of several files has changed is told by size and content, and by its time where that is all that differs."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from tilepipe.engine import unchanged
from tilepipe.engine.unchanged import changed_input

KNOWN = ["10 5 d a.tif", "20 6 e b c.tif", "30 7 f d.tif"]
"""Size, time, digest and name."""


@dataclass
class Source:
    lines: list[str]
    is_known: bool = True
    name: str = "the array"
    read: list[object] = field(default_factory=list)


def changed(now: list[str], tmp_path: Path, **more: object) -> str | None:
    return changed_input(KNOWN, [Source(now[:1]), Source(now[1:], **more)], tmp_path)  # type: ignore[arg-type, list-item]


@pytest.mark.parametrize(
    ("number", "line", "told"),
    [
        (0, "10 5 d a.tif", None),
        (0, "9 5 d a.tif", "a.tif has changed since"),
        (0, "11 5 d a.tif", "a.tif has changed since"),
        (1, "20 6 a b c.tif", "b c.tif has changed since"),
        (2, "30 7 z d.tif", "d.tif has changed since"),
    ],
)
def test_a_file_of_another_size_or_content(tmp_path, number, line, told):
    now = list(KNOWN)
    now[number] = line
    assert changed(now, tmp_path) == told


def test_a_file_that_came_or_went(tmp_path):
    assert changed(KNOWN[:2], tmp_path) == "d.tif was still there when it began"
    assert changed([*KNOWN, "1 1 g new.tif"], tmp_path) == "new.tif was not there when it began"


@pytest.mark.parametrize("time", [4, 9])
@pytest.mark.parametrize("same", [True, False])
def test_of_files_of_another_time_what_was_read_decides(tmp_path, monkeypatch, time, same):
    asked = []
    monkeypatch.setattr(unchanged, "is_unchanged", lambda tables, sources: asked.append(list(tables)) or same)
    now = [KNOWN[0], f"20 {time} e b c.tif", KNOWN[2]]
    assert changed(now, tmp_path) == (None if same else "b c.tif has changed since")
    assert asked == [[]]
    assert changed(KNOWN, tmp_path) is None
    assert len(asked) == 1, "nothing was doubtful"
    assert changed(KNOWN, tmp_path, is_known=False) == (None if same else "the array has changed since")


def test_tables_of_damaged_tiles_are_left_out(tmp_path, monkeypatch):
    class Ledger:
        def __init__(self, folder: Path) -> None:
            self.folder = folder

        def done(self) -> set[int]:
            return {2, 0, 1}

        def facts(self, tile: int, name: str) -> dict[str, np.ndarray]:
            if tile == 1:
                raise ValueError("damaged")
            return {name: np.array([tile, self.folder.name == "b"])}

    monkeypatch.setattr(unchanged, "Ledger", Ledger)
    for name in "ba":
        (tmp_path / name).mkdir()
    (tmp_path / "c").touch()
    assert [table.tolist() for table in unchanged._tables(tmp_path)] == [[0, 0], [2, 0], [0, 1], [2, 1]]
