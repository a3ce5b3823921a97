"""Whether the inputs are still what an unfinished run began with, so that its finished tiles may be used."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tilepipe.engine.tiles.ledger import Ledger
from tilepipe.engine.tiles.passes import READS
from tilepipe.io.rasters.reads import is_unchanged
from tilepipe.io.rasters.sources.source import Source

INPUT_FILES = "files"
"""Entry of a run's identity that holds size, time, digest and name of each file behind its inputs."""


class _Known(NamedTuple):
    """What is known of a file, as texts."""

    size: str
    time: str
    digest: str


def changed_input(known: Sequence[str], sources: Sequence[Source], state: Path) -> str | None:
    """What is no longer as an unfinished run has read it, None when all is.

    Files of which only the times differ, and inputs that no stamp proves to be the same, are read again where finished
    tiles have read them, and the checksums compared.

    Parameters
    ----------
    known
        Files behind the inputs as its identity names them; all else in it is as in this one.
    sources
        Inputs as they are now.
    state
        Folder of its state.
    """
    then, now = _by_name(known), _by_name(line for source in sources for line in source.lines)
    for name in sorted(set(then) | set(now)):
        if name not in now or name not in then:
            return f"{name} was {'not' if name in now else 'still'} there when it began"
        if _content(then[name]) != _content(now[name]):
            return f"{name} has changed since"
    doubtful = then != now or not all(source.is_known for source in sources)
    if doubtful and not is_unchanged(_tables(state), sources):
        written = [name for name in now if then[name] != now[name]] or [s.name for s in sources if not s.is_known]
        return f"{written[0]} has changed since"
    return None


def _by_name(lines: Iterable[str]) -> dict[str, list[_Known]]:
    """What is known of each file; arrays share one name."""
    found: dict[str, list[_Known]] = {}
    for line in dict.fromkeys(lines):
        size, time, digest, name = line.split(" ", 3)
        found.setdefault(name, []).append(_Known(size, time, digest))
    return found


def _content(known: list[_Known]) -> list[tuple[str, str]]:
    return [(item.size, item.digest) for item in known]


def _tables(state: Path) -> Iterator[NDArray[np.uint64]]:
    """What the finished tiles of all passes have read."""
    for folder in sorted(item for item in state.iterdir() if item.is_dir()):
        ledger = Ledger(folder)
        for tile in sorted(ledger.done()):
            try:
                facts = ledger.facts(tile, READS)
            except ValueError:
                continue  # damaged: it will be computed again
            yield facts[READS]
