"""Progress bars on a terminal: one per stage, with the tiles that an earlier run had finished."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from tilepipe.engine.progress import Progress, Silent

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import TaskID


COMPILING = "compiling kernels for this machine: once, for about half a minute"
COMPILING_AGAIN = (
    "compiling kernels, about half a minute each time, for no folder can be written to keep them: set NUMBA_CACHE_DIR"
)


class ProgressBars:
    """Shows each stage as a bar."""

    def __init__(self, bars: Bars) -> None:
        self.bars = bars
        self.tasks: dict[str, TaskID] = {}
        self.told_of_compiling = False

    def start(self, name: str, total: int, done: int = 0) -> None:
        """See `tilepipe.engine.progress.Progress.start`."""
        self.bars.start()
        note = f" ({done} done before)" if done else ""
        self.tasks[name] = self.bars.add_task(f"{name}{note}", total=total, completed=done)

    def advance(self, name: str) -> None:
        """See `tilepipe.engine.progress.Progress.advance`."""
        self.bars.advance(self.tasks[name])

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Progress of work that counts by itself: ``done`` of ``total``."""
        if stage not in self.tasks:
            self.start(stage, total)
        self.bars.update(self.tasks[stage], completed=done, total=total)

    def compiling(self) -> None:
        """See `tilepipe.engine.progress.Progress.compiling`; one line above the bars for all kernels."""
        if not self.told_of_compiling:
            from tilepipe_kernels.core.cache import is_kept

            self.told_of_compiling = True
            self.bars.console.print(COMPILING if is_kept() else COMPILING_AGAIN, highlight=False, soft_wrap=True)


@contextmanager
def progress_bars(quiet: bool) -> Iterator[Progress]:
    """Bars on standard error for the length of a block; nothing when ``quiet``."""
    if quiet:
        yield Silent()
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.progress import Progress as Bars

    from tilepipe_kernels.core.cache import listening

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    shown = ProgressBars(Bars(*columns, console=Console(stderr=True)))
    try:
        with listening(shown.compiling):
            yield shown
    finally:
        # bars that were never started would leave an empty line before an error
        if shown.tasks:
            shown.bars.stop()
