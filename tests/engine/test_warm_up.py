"""What a second process compiles is what a run would have compiled itself."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tilepipe.engine.warm_up import compiled_beside
from tilepipe.pipelines import registry
from tilepipe_kernels.core.cache import tell_compiling


@pytest.mark.parametrize("name", registry.OWN)
def test_the_kernels_of_every_pipeline_can_be_called_on_drawn_data(name: str) -> None:
    registry.part(registry.pipeline(name).warm_up)()


def test_a_process_begins_when_something_is_compiled_and_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[list[str]] = []

    class Process:
        def __init__(self, command: list[str], **_: object) -> None:
            started.append(command)
            self.terminated = False

        def terminate(self) -> None:
            self.terminated = True

        def wait(self) -> None:
            assert self.terminated

    monkeypatch.setattr("tilepipe.engine.warm_up.subprocess.Popen", Process)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    with compiled_beside("package.module:function"):
        assert not started
        tell_compiling()
        tell_compiling()
    [command] = started
    assert command[-1].endswith("; from package.module import function; function()")
    with compiled_beside(""):
        tell_compiling()
    tell_compiling()
    assert len(started) == 1


@pytest.mark.slow
def test_a_run_finds_what_was_compiled_beside_it(tmp_path: Path) -> None:
    """With the kernels of `edges` warm, writing its tables compiles nothing more."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    call = "from tilepipe.pipelines.edges.warm_up import warm_up; warm_up()"
    told = "from tilepipe_kernels.core.cache import listen; listen(lambda: print('compiled'))"
    first, second = (
        subprocess.run(
            [sys.executable, "-c", f"{told}; {call}"], env=environment, capture_output=True, text=True, check=True
        )
        for _ in range(2)
    )
    assert "compiled" in first.stdout and "compiled" not in second.stdout
