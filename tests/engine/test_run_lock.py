"""Who is at work in a folder is known by a lock of the system, a mark and a name, whatever is left of them."""

from __future__ import annotations

import errno
import fcntl
import json
import os
from pathlib import Path

import pytest

from tilepipe.engine import run_lock
from tilepipe.engine.run_lock import MARK, OWNER
from tilepipe.errors import InputError


@pytest.mark.parametrize(
    ("content", "marked"),
    [(MARK, True), (b"", True), (MARK[:-1], False), (MARK + b"x", False), (b"\0", False), (b"\xff" * 60, False)],
)
def test_a_mark_is_whole(tmp_path: Path, content: bytes, marked: bool) -> None:
    (tmp_path / "lock").write_bytes(content)
    assert run_lock.is_marked(tmp_path) == marked


@pytest.mark.parametrize("boot", ["", "zzzz", None])
def test_a_process_of_this_machine_is_not_named(tmp_path: Path, boot: str | None) -> None:
    here = {"host": "here", "boot": run_lock._boot(), "pid": 7}
    plain = f"{tmp_path}: another process is at work in it; wait for it or name another folder"
    assert str(run_lock._at_work(tmp_path, here)) == str(run_lock._at_work(tmp_path, {})) == plain
    if boot is not None:
        assert " (process 7 of here); wait" in str(run_lock._at_work(tmp_path, here | {"boot": boot}))


@pytest.mark.parametrize(
    ("code", "ends"),
    [(code, "not known") for code in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL, errno.EBADF)]
    + [(errno.EAGAIN, "at work"), (errno.EIO, "error")],
)
def test_locks_of_file_systems(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, ends: str) -> None:
    """Some have none, and then the name alone decides."""
    (tmp_path / OWNER).write_text(json.dumps({"host": "far", "boot": "other", "pid": 7}))

    def flock(descriptor: int, operation: int) -> None:
        assert operation == fcntl.LOCK_EX | fcntl.LOCK_NB
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(fcntl, "flock", flock)
    if ends == "not known":
        assert not run_lock._lock(0, tmp_path, tmp_path)
        return
    with pytest.raises(InputError if ends == "at work" else OSError, match=r"process 7 of far|Input/output"):
        run_lock._lock(0, tmp_path, tmp_path)


@pytest.mark.parametrize("content", [b"", b"\n", b"[1]", b"\xff\xfe", b'{"pid": 7}\n3', b'{"pid"'])
def test_a_name_may_be_left_half_written(content: bytes) -> None:
    assert run_lock._read_name(content) == ({"pid": 7} if content.startswith(b'{"pid": 7}') else {})
