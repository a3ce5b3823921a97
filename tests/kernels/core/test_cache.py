"""Compiled code on disk: renewed by a change of all it depends on, shared by the same sources, never in the way."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tilepipe_kernels.core import cache, sources

WALKS = """
import numpy as np

from stranger.rules import raised
from tilepipe_kernels.core.compiled import loop


@loop
def raise_all(values):
    for i in range(values.size):
        values[i] = raised(values[i])


def result():
    values = np.arange(3.0)
    raise_all(values)
    return values.tolist()
"""

RULES = """
from tilepipe_kernels.core.compiled import rule

from . import heights


@rule
def raised(value):
    return value + heights.HEIGHT
"""

version_of = cache._version_of

RUN = """
from stranger.walks import result
from tilepipe_kernels.core.cache import listening

compiled = []
with listening(lambda: compiled.append(1)):
    print(result(), bool(compiled))
"""


def write_package(folder: Path, height: float = 1.0) -> None:
    package = folder / "stranger"
    package.mkdir(parents=True)
    for name, text in {"__init__": "", "walks": WALKS, "rules": RULES, "heights": f"HEIGHT = {height}"}.items():
        (package / f"{name}.py").write_text(text)


def start(folder: Path, **environment: str) -> subprocess.Popen[str]:
    """A process that calls the loop of a package."""
    variables = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_CACHE")}
    path = os.pathsep.join([str(folder), *sys.path])
    return subprocess.Popen(
        [sys.executable, "-c", RUN],
        env={**variables, "PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", **environment},
        stdout=subprocess.PIPE,
        text=True,
    )


def run(folder: Path, **environment: str) -> str:
    process = start(folder, **environment)
    output, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    return output.strip()


@pytest.fixture
def home(tmp_path: Path) -> dict[str, str]:
    return {"XDG_CACHE_HOME": str(tmp_path / "home")}


def test_what_a_loop_depends_on_in_other_files_renews_it(tmp_path: Path, home: dict[str, str]) -> None:
    write_package(tmp_path)
    package = tmp_path / "stranger"
    assert run(tmp_path, **home) == "[1.0, 2.0, 3.0] True"
    assert run(tmp_path, **home) == "[1.0, 2.0, 3.0] False"
    before = (package / "walks.py").stat()
    (package / "rules.py").write_text(RULES.replace("value +", "value -"))
    assert run(tmp_path, **home) == "[-1.0, 0.0, 1.0] True"
    (package / "heights.py").write_text("HEIGHT = 2.0")
    assert run(tmp_path, **home) == "[-2.0, -1.0, 0.0] True"
    assert (package / "walks.py").stat() == before
    assert not list(tmp_path.rglob("__pycache__"))


def test_a_copy_of_the_sources_shares_what_is_compiled(tmp_path: Path, home: dict[str, str]) -> None:
    write_package(tmp_path / "one")
    assert run(tmp_path / "one", **home) == "[1.0, 2.0, 3.0] True"
    shutil.copytree(tmp_path / "one", tmp_path / "two", copy_function=shutil.copyfile)
    assert run(tmp_path / "two", **home) == "[1.0, 2.0, 3.0] False"


def test_without_a_folder_that_can_be_written_a_temporary_one_serves_or_none(tmp_path: Path) -> None:
    write_package(tmp_path)
    (tmp_path / "file").write_text("no folder can be made below a file, not even by root")
    (tmp_path / "temporary").mkdir()
    nowhere = str(tmp_path / "file" / "home")
    somewhere = str(tmp_path / "temporary")
    assert run(tmp_path, XDG_CACHE_HOME=nowhere, TMPDIR=somewhere) == "[1.0, 2.0, 3.0] True"
    assert run(tmp_path, XDG_CACHE_HOME=nowhere, TMPDIR=somewhere) == "[1.0, 2.0, 3.0] False"
    (folder,) = (tmp_path / "temporary").iterdir()
    # a folder of others, or one that they can write, may hold their code
    folder.chmod(0o777)
    assert run(tmp_path, XDG_CACHE_HOME=nowhere, TMPDIR=somewhere) == "[1.0, 2.0, 3.0] True"


def test_a_chosen_folder_holds_all(tmp_path: Path, home: dict[str, str]) -> None:
    write_package(tmp_path)
    chosen = tmp_path / "chosen"
    assert run(tmp_path, **home, NUMBA_CACHE_DIR=str(chosen)) == "[1.0, 2.0, 3.0] True"
    assert run(tmp_path, **home, NUMBA_CACHE_DIR=str(chosen)) == "[1.0, 2.0, 3.0] False"
    assert list(chosen.rglob("*.nbc"))
    assert not Path(home["XDG_CACHE_HOME"]).exists()


def test_processes_that_start_together_and_a_damaged_file(tmp_path: Path, home: dict[str, str]) -> None:
    write_package(tmp_path)
    together = [start(tmp_path, **home) for _ in range(3)]
    for process in together:
        output, _ = process.communicate(timeout=300)
        assert process.returncode == 0
        assert output.startswith("[1.0, 2.0, 3.0]")
    assert run(tmp_path, **home) == "[1.0, 2.0, 3.0] False"
    kept = sorted(tmp_path.rglob("*.nbc"))
    assert {file.parent.name.rpartition("-")[0] for file in kept} == {"stranger.walks", "stranger.rules"}
    for damage in (cut, flip, lambda content: b""):
        for file in kept:
            file.write_bytes(damage(file.read_bytes()))
        assert run(tmp_path, **home) == "[1.0, 2.0, 3.0] True"
        assert run(tmp_path, **home) == "[1.0, 2.0, 3.0] False"


def cut(content: bytes) -> bytes:
    return content[:100]


def flip(content: bytes) -> bytes:
    """One wrong bit, within the machine code."""
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


def test_settings_of_the_compiler_renew_all(tmp_path: Path, home: dict[str, str]) -> None:
    write_package(tmp_path)
    assert run(tmp_path, **home) == "[1.0, 2.0, 3.0] True"
    assert run(tmp_path, **home, NUMBA_BOUNDSCHECK="1") == "[1.0, 2.0, 3.0] True"
    assert run(tmp_path, **home) == "[1.0, 2.0, 3.0] False"


@pytest.mark.parametrize("name", ["numba", "llvmlite", "numpy", "numba-cuda"])
def test_each_library_that_compiles_counts(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    before = cache._compiler.__wrapped__()
    monkeypatch.setattr(cache, "_version_of", lambda one: "other" if one == name else version_of(one))
    assert cache._compiler.__wrapped__() != before


@pytest.mark.parametrize("wrong", ["rules", "walks", "heights"])
def test_text_that_python_takes_for_what_it_compiled_before_is_not_kept(
    tmp_path: Path, home: dict[str, str], wrong: str
) -> None:
    write_package(tmp_path)
    package = tmp_path / "stranger"
    # Python's own compiled files are written this time
    writing = {**home, "PYTHONDONTWRITEBYTECODE": ""}
    assert run(tmp_path, **writing) == "[1.0, 2.0, 3.0] True"
    path = package / f"{wrong}.py"
    changed = {
        "rules": ("value +", "value -"),
        "walks": ("raised(values[i])", "raised(2*i + 0.0)"),
        "heights": ("1", "5"),
    }
    state = path.stat()
    path.write_text(path.read_text().replace(*changed[wrong]))
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns))
    # Python runs the old code, which must not pass for the new text's
    assert run(tmp_path, **writing) == "[1.0, 2.0, 3.0] True"
    shutil.rmtree(package / "__pycache__")
    expected = {"rules": "[-1.0, 0.0, 1.0]", "walks": "[1.0, 3.0, 5.0]", "heights": "[5.0, 6.0, 7.0]"}[wrong]
    assert run(tmp_path, **writing).startswith(expected)


def test_no_folder_is_made_of_a_home_that_is_not_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    monkeypatch.setattr(cache.numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(cache.tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    # what Python gives back where the user has no name
    monkeypatch.setattr(cache.os.path, "expanduser", lambda path: path)
    (tmp_path / "temporary").mkdir()
    assert Path(cache._root.__wrapped__()).parent == tmp_path / "temporary"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["temporary"]


def test_the_start_is_that_of_the_process() -> None:
    code = "import time; time.sleep(1); now = time.time(); from tilepipe_kernels.core import sources\n"
    code += "print(now - sources._START)"
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 1 <= float(output.stdout) < 60


def test_who_listens_hears_of_it_for_as_long_as_wanted() -> None:
    heard = []
    with cache.listening(lambda: heard.append("one")), cache.listening(lambda: heard.append("two")):
        cache.tell_compiling()
    cache.tell_compiling()
    assert heard == ["one", "two"]


def test_what_was_not_loaded_for_long_is_deleted(tmp_path: Path) -> None:
    old, recent, new = tmp_path / "old-0", tmp_path / "recent-0", tmp_path / "new-0"
    for folder, days in ((old, cache.UNUSED_DAYS + 1), (recent, cache.UNUSED_DAYS - 1)):
        folder.mkdir()
        (folder / "loop.nbc").write_text("code")
        os.utime(folder, (time.time() - days * 86400,) * 2)
    files = cache._Files(str(new), "loop", "stamp", lambda data: b"")
    files.save("signature", None)
    assert sorted(tmp_path.iterdir()) == [new, recent]


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    write_package(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    # as if this process had started after the package was written
    monkeypatch.setattr(sources, "_START", time.time() + 60)
    __import__("stranger")
    clear()
    yield tmp_path / "stranger"
    for name in [name for name in sys.modules if name.partition(".")[0] == "stranger"]:
        del sys.modules[name]
    clear()


def clear() -> None:
    for function in (sources.fingerprint, sources._file_of, sources._read, sources._is_loaded_as_written):
        function.cache_clear()


def fingerprint(package: Path) -> str | None:
    clear()
    return sources.fingerprint("stranger.walks", str(package / "walks.py"))


@pytest.mark.parametrize(
    "text",
    [
        "from stranger import extra",
        "from stranger import (  # a remark (in brackets)\n    rules,\n    extra as more,\n)",
        "from stranger import rules, \\\n    extra",
        "from stranger.extra import *",
        "from . import extra",
        "from .extra import NAME",
        "from ..stranger.extra import NAME",
        "import math, stranger.extra as more",
        "if True: import stranger.extra",
    ],
)
def test_imports_are_found_however_they_are_written(package: Path, text: str) -> None:
    (package / "extra.py").write_text("ONE = 1")
    (package / "rules.py").write_text(f"{RULES}\n{text}\n")
    first = fingerprint(package)
    assert first == fingerprint(package)
    (package / "extra.py").write_text("ONE = 2")
    assert fingerprint(package) not in (first, None)


def test_what_is_not_imported_changes_nothing(package: Path) -> None:
    first = fingerprint(package)
    (package / "extra.py").write_text("from stranger.walks import raise_all")
    assert first == fingerprint(package) is not None


def test_names_that_a_package_makes_when_asked_may_come_from_any_of_its_files(package: Path) -> None:
    (package / "lazy").mkdir()
    (package / "lazy" / "__init__.py").write_text("def __getattr__(name): ...")
    (package / "lazy" / "extra.py").write_text("ONE = 1")
    (package / "rules.py").write_text(f"{RULES}\nfrom stranger.lazy import ONE\n")
    first = fingerprint(package)
    (package / "lazy" / "extra.py").write_text("ONE = 2")
    assert fingerprint(package) not in (first, None)


def test_sources_that_changed_after_the_start_are_not_known(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert fingerprint(package) is not None
    monkeypatch.setattr(sources, "_START", time.time() - 60)
    assert fingerprint(package) is None
    assert sources.fingerprint("notebook", "<ipython-input-1>") is None
