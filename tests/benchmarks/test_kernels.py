"""The benchmarks run: every case of ours on a tiny scene, tables, the watching of commands."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pytest

from benchmarks.kernels.page import run_kernels
from benchmarks.measure.commands import stage_table
from benchmarks.measure.contest import Case, Contestant, Unsuitable, measure
from benchmarks.measure.machine import Machine, copy_bandwidth
from benchmarks.measure.tables import comparison, number
from benchmarks.measure.watch import Watched, time_to_first_file, watch
from benchmarks.streets.page import Outcome, Scene, _speed_table
from tilepipe.evaluate.lines import LineScore

MACHINE = Machine("a processor", 2, 8 << 30, "3.11", {"numpy": "2"}, "2026-01-01", 0.0, 1e9)


def missing() -> object:
    raise ModuleNotFoundError("No module named 'nothing'", name="nothing")


def unsuitable() -> object:
    raise Unsuitable("has no such thing")


def test_every_case_of_ours_runs_on_a_tiny_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.kernels.page.describe_machine", lambda: MACHINE)
    measured = run_kernels(
        size=128, engine_size=128, repetitions=1, peers=False, patience=math.inf, scratch=tmp_path,
        results=tmp_path / "results",
    )  # fmt: skip
    assert len(measured) == 15
    for case, measurements in measured:
        ours = [m for m in measurements if m.contestant.ours]
        assert ours and all(m.rate(case) > 0 and m.rate(case, one_core=True) > 0 for m in ours)
        assert all(m.skipped for m in measurements if not m.contestant.ours)
    page = (tmp_path / "results" / "kernels.md").read_text()
    assert all(f"| {case.name} |" in page for case, _ in measured)
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


def test_contestants_take_turns_and_the_missing_are_named() -> None:
    calls: list[tuple[str, int]] = []

    def build(name: str):
        return lambda: lambda workers: calls.append((name, workers))

    case = Case(
        "case",
        "Mpx/s",
        1.0,
        8,
        [
            Contestant("ours", build("ours"), ours=True),
            Contestant("serial", build("serial"), serial=True),
            Contestant("missing", missing),
            Contestant("unsuitable", unsuitable),
        ],
        aim=1e-9,
    )
    found = measure(case, workers=2, repetitions=2)
    timed = [("ours", 2), ("ours", 1), ("serial", 2)]
    assert calls[: 2 + 2 * len(timed)] == [("ours", 2), ("serial", 2), *timed, *timed]
    assert [len(m.one_core) for m in found] == [2, 2, 0, 0]
    assert found[2].skipped == "not installed: nothing" and found[3].skipped == "has no such thing"
    rows = comparison("t", [(case, found)], MACHINE).rows
    assert rows[0][:2] == ["case", "**ours**"] and rows[0][5].endswith("×") and "reached" in rows[0][-1]
    assert rows[2][-1] == "skipped: not installed: nothing"


def test_the_slow_are_timed_once_after_a_small_call_has_compiled(capsys: pytest.CaptureFixture[str]) -> None:
    calls: list[str] = []

    def build(name: str):
        return lambda: lambda workers: calls.append(name)

    contestants = [
        Contestant("large", build("large"), ours=True, small=build("small")),
        Contestant("peer", build("peer")),
        # the first call of this one may have compiled
        Contestant("plain", build("plain"), ours=True),
    ]
    case = Case("case", "Mpx/s", 1.0, 8, contestants)
    found = measure(case, workers=2, repetitions=3, patience=-1.0)
    assert calls == ["small", "large", "peer", "plain", "plain"]
    assert all(len(m.all_cores) == 1 and not m.one_core and m.peak is None for m in found)
    assert math.isnan(found[0].rate(case, one_core=True))
    assert [row[4] for row in comparison("t", [(case, found)], MACHINE).rows] == ["–"] * 3
    assert capsys.readouterr().out.count(" s, once\n") == 3


def test_peak_memory_counts_what_a_call_allocates() -> None:
    import numpy as np

    size = 32 << 20

    def build():
        return lambda workers: np.ones(size, np.uint8)

    found = measure(Case("c", "u", 1.0, 1, [Contestant("ones", build, ours=True)]), workers=1)[0]
    if found.peak is None:
        pytest.skip("this system does not tell")
    assert size <= found.peak < 1.5 * size


def test_numbers_and_bandwidth() -> None:
    assert [number(x) for x in (1234.5, 12.34, 1.234, 0.0123, math.nan)] == ["1,234", "12.3", "1.2", "0.012", "–"]
    assert copy_bandwidth(2, size=1 << 20, repetitions=2) > 1e6


def test_watch_sees_time_memory_and_failure(tmp_path: Path) -> None:
    seen = watch([sys.executable, "-c", "import time; x = bytearray(64 << 20); time.sleep(0.2)"])
    assert seen.seconds >= 0.2 and (seen.peak == 0 or 64 << 20 < seen.peak < 512 << 20)
    with pytest.raises(RuntimeError, match="no good"):
        watch([sys.executable, "-c", "raise SystemExit('no good')"])
    code = f"import time, pathlib; pathlib.Path({str(tmp_path)!r}, 'a.facts').touch(); time.sleep(60)"
    assert time_to_first_file([sys.executable, "-c", code], tmp_path, "*.facts") < 30


def test_tables_of_streets() -> None:
    score = LineScore(0.9, 0.8, 0.7, 0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 3.0)
    runs, stages = [Watched(2.0, 1 << 30)], [{"a": 0.5, "b": 1.0}]
    ours = Outcome("ours", Scene(1000), runs, stages=stages, scores={"centerlines": score})
    plain = Outcome("plain", Scene(1000), skipped="too large")
    speed = _speed_table([ours, plain], 50)
    assert speed.rows[0][2:6] == ["0.5", "2.0", "2.0", "1.00"] and speed.rows[0][7] == "90.0 %"
    assert all(len(row) == len(speed.columns) for row in speed.rows)
    told = "a 0.5 s (25%), b 1.0 s (50%), start and the rest 0.5 s (25%)"
    assert stage_table([ours, plain]).rows == [["1000² = 1 Mpx", "ours", told]]
