"""The distribution: what it declares, what it pins, how it is started, and how its imports are layered."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {"tilepipe": ROOT / "tilepipe", "tilepipe_kernels": ROOT / "kernels" / "tilepipe_kernels"}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
CONSTRAINTS = [
    line for line in (ROOT / "constraints.txt").read_text().splitlines() if line and not line.startswith("#")
]

# Distributions whose import name is another.
IMPORT_NAMES = {"pillow": "PIL", "scikit-image": "skimage", "cupy-cuda12x": "cupy", "numba-cuda": "numba"}


def distribution_name(requirement: str) -> str:
    """The normalised name at the start of a requirement or pin."""
    match = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert match, requirement
    return re.sub(r"[-_.]+", "-", match.group()).lower()


def import_name(distribution: str) -> str:
    return IMPORT_NAMES.get(distribution, distribution.replace("-", "_"))


def imported_names(folder: Path) -> Iterator[tuple[str, str]]:
    """Each top-level name that a module of the folder imports from outside itself, with the module's path."""
    for path in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                yield from ((alias.name.split(".")[0], path.name) for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                yield node.module.split(".")[0], path.name


def run(arguments: list[str], folder: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, **variables}
    return subprocess.run(
        arguments, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=120
    )


def test_every_import_is_declared() -> None:
    requirements = PROJECT["project"]["dependencies"] + PROJECT["project"]["optional-dependencies"]["gpu"]
    declared = {import_name(distribution_name(requirement)) for requirement in requirements}
    # cupyx comes with cupy
    known = declared | {"cupyx"} | set(sys.stdlib_module_names) | set(PACKAGES)
    undeclared = {
        f"{name} ({file})" for folder in PACKAGES.values() for name, file in imported_names(folder) if name not in known
    }
    assert not undeclared, f"add to the dependencies in pyproject.toml: {sorted(undeclared)}"


def test_every_dependency_is_used() -> None:
    used = {name for folder in PACKAGES.values() for name, _ in imported_names(folder)}
    declared = {distribution_name(requirement) for requirement in PROJECT["project"]["dependencies"]}
    unused = {name for name in declared if import_name(name) not in used}
    assert not unused, f"remove from the dependencies in pyproject.toml: {sorted(unused)}"


def test_constraints_pin_every_requirement_and_name_no_address() -> None:
    for line in CONSTRAINTS:
        assert re.fullmatch(r"[a-z0-9-]+==[0-9][0-9a-z.]*( ; python_version < \"3\.1[23]\")?", line), line
    pinned = [distribution_name(line) for line in CONSTRAINTS]
    assert pinned == sorted(set(pinned))
    requirements = list(PROJECT["project"]["dependencies"])
    for extra in PROJECT["project"]["optional-dependencies"].values():
        requirements += extra
    assert {distribution_name(requirement) for requirement in requirements} <= set(pinned)


def test_versions_agree() -> None:
    tree = ast.parse((PACKAGES["tilepipe"] / "__init__.py").read_text())
    (version,) = (
        ast.literal_eval(node.value)
        for node in tree.body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__version__"
    )
    assert version == PROJECT["project"]["version"]
    assert f"## [{version}]" in (ROOT / "CHANGELOG.md").read_text()


def test_kernels_stand_alone(tmp_path: Path) -> None:
    forbidden = "tilepipe dask distributed xarray rasterio pandas zarr shapely cupy"
    program = (
        "import sys, pkgutil, importlib, tilepipe_kernels as package\n"
        "for module in pkgutil.walk_packages(package.__path__, 'tilepipe_kernels.'):\n"
        "    if '.device' not in module.name:\n"
        "        importlib.import_module(module.name)\n"
        f"print(sorted(set('{forbidden}'.split()) & set(sys.modules)))\n"
    )
    kernels = str(PACKAGES["tilepipe_kernels"].parent)
    result = run([sys.executable, "-c", program], tmp_path, PYTHONPATH=kernels)
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A checkout whose .venv is a stand-in: its python is 3.11 and notes down what it is asked to run."""
    (tmp_path / "scripts").mkdir()
    for name in ("environment", "demo", "test"):
        (tmp_path / "scripts" / name).write_text((ROOT / "scripts" / name).read_text())
    (tmp_path / "pyproject.toml").write_text("")
    (tmp_path / "constraints.txt").write_text("")
    (tmp_path / ".venv" / "bin").mkdir(parents=True)
    program(
        tmp_path / ".venv" / "bin" / "python",
        'case "$*" in *print*) echo 3.11;; -c*) ;; *) echo "ran $*" >>calls;; esac',
    )
    return tmp_path


def program(path: Path, body: str) -> None:
    path.write_text(f"#!/bin/sh\n{body}\n")
    path.chmod(0o755)


@pytest.mark.parametrize("script", ["demo", "test"])
def test_scripts_refuse_an_old_python(checkout: Path, script: str) -> None:
    pretend = "import sys; sys.version_info = (3, 9, 18, 'final', 0); exec(sys.argv[1])"
    program(checkout / "python3.9", f'exec {sys.executable} -c "{pretend}" "$2"')
    old = str(checkout / "python3.9")
    result = run(["bash", f"scripts/{script}"], checkout, PYTHON=old)
    assert result.returncode == 2
    assert result.stderr == f"{script}: PYTHON={old} is Python 3.9; tilepipe needs 3.11 or newer\n"
    missing = run(["bash", f"scripts/{script}"], checkout, PYTHON="no-such-python")
    assert missing.returncode == 2
    assert len(missing.stderr.splitlines()) == 1


def test_scripts_install_once_and_again_when_the_pins_change(checkout: Path) -> None:
    def installs(script: str) -> list[str]:
        (checkout / "calls").unlink(missing_ok=True)
        result = run(["bash", f"scripts/{script}", "--flag"], checkout, PYTHON="")
        assert result.returncode == 0, result.stderr
        calls = (checkout / "calls").read_text().splitlines()
        assert calls[-1].startswith({"demo": "ran -m tilepipe demo", "test": "ran -m pytest"}[script])
        assert calls[-1].endswith(" --flag")
        return [call.split()[-1] for call in calls if " install " in call]

    assert installs("demo") == ["."]
    assert installs("demo") == []
    assert installs("test") == [".[dev]"]
    assert installs("demo") == installs("test") == []
    (checkout / "constraints.txt").write_text("numpy==2\n")
    assert installs("test") == [".[dev]"]
    assert installs("demo") == []
