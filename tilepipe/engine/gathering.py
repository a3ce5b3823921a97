"""What reconciliations gather of a whole raster: the most that there can be, and what there is once a pass is done."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tilepipe.engine.options import format_memory
from tilepipe.engine.pipeline import Pass, Setting, amount
from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.errors import MemoryLimitError

if TYPE_CHECKING:
    from tilepipe.engine.planning import Plan


def most_cracks(setting: Setting) -> int:
    """Sides of pixels of a raster, those on its border too: more borders and edge lines than these there are not.

    Examples
    --------
    >>> from tilepipe.engine.gathering import most_cracks
    >>> from tilepipe.engine.pipeline import Setting
    >>> most_cracks(Setting(parameters=None, shape=(1, 2), resolution=0.5, tile=64))
    7
    """
    rows, columns = setting.shape
    return rows * (columns + 1) + (rows + 1) * columns


def most_gathered(declared: Pass, setting: Setting) -> int:
    """Most bytes that what follows a pass holds, whatever the raster holds.

    Examples
    --------
    >>> from tilepipe.engine.gathering import most_gathered
    >>> from tilepipe.engine.pipeline import Gathered, Pass, Setting
    >>> peaks = Gathered("peaks", "peak", bytes_per_row=40, most=lambda setting: setting.shape[0])
    >>> find = Pass("find", lambda context, tile: {}, halo=1, bytes_per_pixel=8, gathers=(peaks,))
    >>> most_gathered(find, Setting(parameters=None, shape=(100, 200), resolution=0.5, tile=64))
    4000
    """
    return sum(item.most(setting) * amount(item.bytes_per_row, setting) for item in declared.gathers)


@dataclass
class Gathering:
    """What the passes of a run have left to gather, held against its plan.

    Attributes
    ----------
    plan
        Of the run.
    setting
        What its passes depend on.
    held
        Bytes for each pass that is done, by its name.
    """

    plan: Plan
    setting: Setting
    held: dict[str, int] = field(default_factory=dict)

    def count(self, declared: Pass, ledger: Ledger) -> None:
        """Count what a pass has left, before anything of it is gathered.

        Raises
        ------
        MemoryLimitError
            When it needs more than ``--memory`` together with all else; says of what there is so much, and what to do.
        """
        if not declared.gathers:
            return
        rows = ledger.rows()
        self.held[declared.name] = sum(
            rows[item.rows] * amount(item.bytes_per_row, self.setting) for item in declared.gathers
        )
        gathered = sum(self.held.values())
        if self.plan.memory_with(gathered) > self.plan.limit:
            raise MemoryLimitError(_refusal(declared, rows, gathered, self.plan))


def _refusal(declared: Pass, rows: Mapping[str, int], gathered: int, plan: Plan) -> str:
    found = " and ".join(f"{rows[item.rows]:,} {item.items}" for item in declared.gathers)
    needed = format_memory(plan.memory_with(gathered))
    # where nobody has named their number, more memory would mean more of them
    larger = f"a larger --memory, such as --memory {needed.replace(' ', '')} --workers {plan.workers}"
    held = plan.workers_within(gathered)
    fewer = (f" or with --workers {held}" if held else "") + ", which goes on from here"
    return (
        f"pass {declared.name} has found {found}, for which the run needs about {needed}, but --memory is "
        f"{format_memory(plan.limit, up=False)}; run the same command with {larger}{fewer}"
        f"{f', or {declared.fewer}' if declared.fewer else ''}"
    )
