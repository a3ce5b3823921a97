"""Which tiles of which pass are done, and what facts they left: the files that make a run resumable.

A finished tile leaves one file ``<pass>/<tile>.facts`` written atomically, which holds its facts and the
checksums of all that it wrote elsewhere.  On resume the file is read and the checksums are compared with what lies
on disk; a tile that does not verify is computed again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tilepipe.engine.tiles.facts_file import count_rows, pack, read_facts
from tilepipe.io.files.durable import atomic_write_bytes
from tilepipe.tiling.facts import Facts

_SUFFIX = ".facts"


@dataclass(frozen=True)
class Ledger:
    """The facts of one pass, one file a tile, in ``folder``.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from tilepipe.engine.tiles.ledger import Ledger
    >>> ledger = Ledger(Path("regions"))
    >>> ledger.record("r0c0", {"count": np.array([7])})
    >>> ledger.done(), ledger.facts("r0c0")["count"].item()
    ({'r0c0'}, 7)
    """

    folder: Path

    def path(self, tile_name: str) -> Path:
        """File of a tile's facts."""
        return self.folder / f"{tile_name}{_SUFFIX}"

    def record(self, tile_name: str, facts: Facts) -> None:
        """Mark a tile as done, with its facts.

        Raises
        ------
        FileNotFoundError
            When the folder of the state is gone: another run has begun, and nobody wants this tile.
        """
        self.folder.mkdir(exist_ok=True)
        atomic_write_bytes(self.path(tile_name), *pack(facts))

    def facts(self, tile_name: str, prefix: str = "") -> Facts:
        """Facts of a finished tile whose names begin with ``prefix``.

        Raises
        ------
        ValueError
            When the file is damaged.
        FileNotFoundError
            When the tile is not done.
        """
        return read_facts(self.path(tile_name), prefix)

    def all_facts(self) -> list[Facts]:
        """Facts of all finished tiles in row-major order."""
        return list(self.each())

    def each(self) -> Iterator[Facts]:
        """Facts of all finished tiles in row-major order, one after the other."""
        names = sorted(self.done(), key=lambda name: [int(part) for part in name[1:].split("c")])
        return (self.facts(name) for name in names)

    def is_done(self, tile_name: str) -> bool:
        """Whether a whole file says that a tile is done.

        Raises
        ------
        ValueError
            When the file is damaged.
        """
        try:
            # no name begins so: the file is checked, and no array is read
            self.facts(tile_name, prefix="\0")
        except FileNotFoundError:
            return False
        return True

    def rows(self) -> Counter[str]:
        """Rows of each fact, of all finished tiles together; reads no more than the heads of their files.

        Examples
        --------
        >>> from pathlib import Path
        >>> import numpy as np
        >>> from tilepipe.engine.tiles.ledger import Ledger
        >>> ledger = Ledger(Path("leaves"))
        >>> for tile in ("r0c0", "r0c1"):
        ...     ledger.record(tile, {"edges": np.zeros((5, 2), np.int32)})
        >>> ledger.rows()["edges"]
        10
        """
        total: Counter[str] = Counter()
        for name in self.done():
            total.update(count_rows(self.path(name)))
        return total

    def forget(self, tile_name: str) -> None:
        """Mark a tile as not done."""
        self.path(tile_name).unlink(missing_ok=True)

    def done(self) -> set[str]:
        """Names of the tiles marked as done (not yet verified)."""
        if not self.folder.is_dir():
            return set()
        return {path.name[: -len(_SUFFIX)] for path in self._files()}

    def _files(self) -> Iterator[Path]:
        return (p for p in self.folder.iterdir() if p.name.endswith(_SUFFIX) and not p.name.startswith("."))
