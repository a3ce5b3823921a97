"""The comparison of GPU and CPU: its table, its page, and that it says when something is wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.gpu import check
from benchmarks.gpu.cases import GpuCase
from tilepipe_kernels.core import arrays
from tilepipe_kernels.regions.quadtree import LeafTable

TINY = ["--size", "16", "--checked-size", "16", "--host-size", "16", "--rounds", "1", "--no-pipelines"]


def zeros(size: int) -> tuple[np.ndarray]:
    return (np.zeros((size, size), np.float32),)


def on_device_only(change: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda values: change(values) if arrays.on_device(values) else values.copy()


def fail(error: Exception) -> Callable[[Any], Any]:
    def raise_it(values: Any) -> Any:
        raise error

    return on_device_only(raise_it)


def one_pixel_more(values: Any) -> Any:
    changed = values.copy()
    changed[3, 4] += 0.5
    return changed


def rows_of(page: Path) -> dict[str, list[str]]:
    """Cells of each line of the page's table by the name of the kernel."""
    lines = [line for line in page.read_text().splitlines() if line.startswith("|")]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert {len(row) for row in cells} == {len(check.HEADER)}
    assert tuple(cells[0]) == check.HEADER
    return {row[0]: row[1:] for row in cells[2:]}


def test_kernels_of_one_name_make_a_table_and_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert check.main([*TINY, "--only", "leaves", "--out", str(tmp_path)]) == 0
    (page,) = tmp_path.iterdir()
    assert page.name == f"gpu-{check.device_name().lower().replace(' ', '-')}.md"
    rows = rows_of(page)
    assert set(rows) == {"contacts of leaves", "heights of leaves"}
    for agreement, rate, share, gain, note in rows.values():
        assert agreement == "the same"
        assert float(rate) > 0
        assert share.endswith("%")
        assert float(gain.removesuffix(" x")) >= 0
        assert note == ""
    assert page.read_text().startswith("# GPU check: ")
    assert page.read_text() in capsys.readouterr().out


def test_a_part_of_the_kernels_writes_no_page_unasked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(check, "__file__", str(tmp_path / "gpu" / "check.py"))
    monkeypatch.setattr(check, "cases", lambda: [GpuCase("copy", zeros, lambda values: values.copy(), 8)])
    assert check.main([*TINY, "--only", "copy"]) == 0
    assert not list(tmp_path.iterdir())
    assert check.main(TINY) == 0
    assert len(list(tmp_path.iterdir())) == 1


def test_what_fails_is_a_line_of_the_table_and_the_others_go_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def no_scene(size: int) -> Any:
        raise ValueError("no scene")

    kernels = [
        GpuCase("speaks", zeros, fail(ValueError("a | b\nand more")), 8),
        GpuCase("silent", zeros, fail(NotImplementedError()), 8),
        GpuCase("without input", no_scene, lambda values: values, 8),
        GpuCase("wrong", zeros, on_device_only(one_pixel_more), 8),
        GpuCase("near", zeros, on_device_only(one_pixel_more), 8, tolerance=0.5),
        GpuCase("right", zeros, lambda values: values.copy(), 8, unit="node updates"),
    ]
    monkeypatch.setattr(check, "cases", lambda: kernels)
    assert check.main([*TINY, "--out", str(tmp_path)]) == 1
    (page,) = tmp_path.iterdir()
    rows = rows_of(page)
    assert rows["speaks"] == ["FAILED", "", "", "", "ValueError: a / b"]
    assert rows["silent"][-1] == "NotImplementedError: no message"
    assert rows["without input"] == ["FAILED", "", "", "", "ValueError: no scene"]
    assert rows["wrong"][0] == "FAILED: within 5.0e-01"
    assert rows["near"][0] == "within 5.0e-01"
    assert (rows["right"][0], rows["right"][-1]) == ("the same", "node updates")
    monkeypatch.setattr(check, "cases", lambda: kernels[4:])
    assert check.main([*TINY, "--out", str(tmp_path)]) == 0


def table(**changes: Any) -> LeafTable:
    whole = np.arange(3)
    columns = {"first": whole, "level": whole, "count": whole, "total": whole, "squares": whole}
    return LeafTable(**{**columns, **changes})


FLOATS = np.array([0.0, np.nan, np.inf, 2.0], np.float32)


@pytest.mark.parametrize(
    ("found", "tolerance", "expected"),
    [
        (FLOATS.copy(), 0.0, (True, "the same")),
        (FLOATS + np.float32(0.25), 0.25, (True, "within 2.5e-01")),
        (FLOATS + np.float32(0.25), 0.2, (False, "within 2.5e-01")),
        (np.array([0.0, 1.0, np.inf, 2.0], np.float32), 9.0, (False, "differs in missing values")),
        (np.array([0.0, np.nan, -np.inf, 2.0], np.float32), 9.0, (False, "within inf")),
        (FLOATS[:3], 9.0, (False, "differs in shape")),
        (FLOATS.astype(np.float64), 9.0, (False, "differs in dtype")),
    ],
)
def test_agreement_of_numbers(found: np.ndarray, tolerance: float, expected: tuple[bool, str]) -> None:
    assert check.agreement(FLOATS, arrays.to_device(found), tolerance) == expected


def test_agreement_finds_a_difference_anywhere_in_a_result() -> None:
    labels = np.arange(12, dtype=np.int32).reshape(3, 4)
    expected = labels, table(), None, 5
    assert check.agreement(expected, (labels.copy(), table(), None, 5), 0.0) == (True, "the same")
    wrong = labels.copy()
    wrong[2, 1] += 1
    assert check.agreement(expected, (wrong, table(), None, 5), 9.0) == (False, "1 of 12 differ")
    planted = table(total=np.array([0, 9, 2]))
    assert check.agreement(expected, (labels, planted, None, 5), 9.0) == (False, "1 of 3 differ")
    assert check.agreement(expected, (labels, table(), None, 6), 9.0) == (False, "1 of 1 differ")


def test_an_unknown_kernel_is_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert check.main([*TINY, "--only", "nothing of this name"]) == 2
    assert "no kernel has 'nothing of this name' in its name" in capsys.readouterr().err


def test_without_a_gpu_there_is_one_clear_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    if not arrays.why_no_device():
        pytest.skip("there is a GPU here")
    monkeypatch.setenv("NUMBA_ENABLE_CUDASIM", "0")
    assert check.main([*TINY, "--only", "leaves"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    (line,) = printed.err.splitlines()
    assert line.startswith("scripts/gpu-check: cupy ")


@pytest.mark.parametrize("option", ["--size", "--checked-size", "--host-size", "--rounds"])
def test_nothing_is_not_compared(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        check.main([*TINY, option, "0"])
    assert ended.value.code == 2
    assert "must be 1 or more" in capsys.readouterr().err
