"""Results as a table on the terminal and as Markdown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.measure.contest import Case, Measurement
from benchmarks.measure.machine import Machine

RESULTS = Path(__file__).resolve().parents[1] / "results"

COLUMNS = (
    "case", "contestant", "all cores", "best", "one core", "times the best peer", "per core", "peak MiB",
    "bandwidth", "note",
)  # fmt: skip

LEGEND = (
    "Rates are medians over the rounds, *best* the fastest round; contestants take turns. **Ours** runs as on "
    "tiles: one serial loop per core, on blocks with their halo, which counts as no work. *times the best peer* "
    "compares on all cores, *per core* on one. *peak* is what a call adds to memory, its result included. "
    "*bandwidth* is the traffic of each array counted once per pass over it, as a share of the copy bandwidth."
)


@dataclass(frozen=True)
class Table:
    """Rows under one title; Markdown may stand in the cells."""

    title: str
    columns: Sequence[str]
    rows: list[list[str]] = field(default_factory=list)

    def markdown(self) -> str:
        """The table in Markdown."""
        head = [f"## {self.title}", "", _line(self.columns), _line(["---"] * len(self.columns))]
        return "\n".join([*head, *(_line(row) for row in self.rows), ""])

    def shown(self) -> list[str]:
        """Print it; returns it in Markdown, as a part of a page."""
        self.show()
        return [self.markdown()]

    def show(self) -> None:
        """Print it."""
        from rich.console import Console
        from rich.table import Table as RichTable

        table = RichTable(*self.columns, title=self.title or None)
        for row in self.rows:
            table.add_row(*(cell.replace("**", "") for cell in row))
        console = Console()
        # A file or a pipe has no width, so nothing is gained by wrapping for it.
        (console if console.is_terminal else Console(width=200)).print(table)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "/") for cell in cells) + " |"


def comparison(title: str, results: Sequence[tuple[Case, list[Measurement]]], machine: Machine) -> Table:
    """The table of `COLUMNS` for measured cases."""
    table = Table(title, COLUMNS)
    for case, measurements in results:
        ranked = [m for m in measurements if m.all_cores and not m.contestant.ours]
        peer = max((m.rate(case) for m in ranked), default=math.nan)
        peer_core = max((m.rate(case, one_core=True) for m in ranked if m.one_core), default=math.nan)
        for number, measurement in enumerate(measurements):
            name = case.name if number == 0 else ""
            table.rows.append([name, *_cells(case, measurement, peer, peer_core, machine)])
    return table


def _cells(case: Case, measurement: Measurement, peer: float, peer_core: float, machine: Machine) -> list[str]:
    contestant = measurement.contestant
    name = f"**{contestant.name}**" if contestant.ours else contestant.name
    if measurement.skipped:
        return [name, *[""] * 7, f"skipped: {measurement.skipped}"]
    rate, core = measurement.rate(case), measurement.rate(case, one_core=True)
    bandwidth = rate / case.work * case.traffic / machine.bandwidth
    notes = [contestant.note]
    if contestant.ours and case.aim is not None:
        notes.insert(0, f"aim {case.aim:g}: {'reached' if rate >= case.aim else 'missed'}")
    return [
        name,
        f"{number(rate)} {case.unit}",
        number(measurement.rate(case, best=True)),
        number(core),
        f"{number(rate / peer)} ×" if contestant.ours and not math.isnan(peer) else "",
        f"{number(core / peer_core)} ×" if contestant.ours and not math.isnan(core / peer_core) else "",
        "" if measurement.peak is None else f"{measurement.peak / 2**20:.0f}",
        f"{bandwidth:.0%}" if bandwidth >= 0.01 else "< 1%",
        "; ".join(filter(None, notes)),
    ]


def number(value: float) -> str:
    """Two significant digits, three from 10 on."""
    if math.isnan(value):
        return "–"
    return f"{value:,.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2g}"


def save(name: str, machine: Machine, parts: Sequence[str], folder: Path) -> Path:
    """Write a page of results and say where it is."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.md"
    body = [f"# {name}", "", *machine.lines(), "", *parts]
    path.write_text("\n".join(body).rstrip() + "\n")
    print(path)
    return path
