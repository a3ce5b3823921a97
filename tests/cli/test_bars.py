"""The progress bars: what they say on standard error beside the bars."""

from __future__ import annotations

import pytest

from tilepipe.cli.bars import COMPILING, COMPILING_AGAIN, progress_bars
from tilepipe_kernels.core import cache
from tilepipe_kernels.core.cache import tell_compiling


@pytest.mark.parametrize("stages", [[], ["leaves"]])
def test_compilation_is_told_once_in_a_line_of_its_own(stages: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bars(quiet=False) as progress:
        for stage in stages:
            progress.start(stage, 2, 0)
        tell_compiling()
        tell_compiling()
    tell_compiling()
    printed = capsys.readouterr()
    assert [line.strip() for line in printed.err.splitlines() if "compil" in line] == [COMPILING]
    assert printed.out == ""


def test_without_compilation_or_when_quiet_nothing_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bars(quiet=False):
        pass
    with progress_bars(quiet=True):
        tell_compiling()
    assert capsys.readouterr() == ("", "")


def test_what_no_folder_can_keep_is_told_to_be_compiled_each_time(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache, "_root", lambda: cache._NOWHERE)
    with progress_bars(quiet=False):
        tell_compiling()
    assert capsys.readouterr().err.strip() == COMPILING_AGAIN
