"""How the least energy is searched for: one choice of options for labels, lines and both at once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

from tilepipe_kernels.mrf.annealing import Annealing

Method = Literal["parallel", "serial", "icm", "annealing", "messages"]

MOST_ROUNDS = 2**16 - 1
LARGEST_SCALES = 10


@dataclass(frozen=True)
class Search:
    """Optimiser and its options; each method heeds those that are its own.

    Parameters
    ----------
    method
        - ``parallel``: Highest Confidence First (HCF) in rounds (Swain & Wixson 1992), in which all sites change at
          once that are the least stable of their neighbourhood; the fastest, for strong data.
        - ``serial``: HCF with a heap (Chou & Brown 1990): the least stable site of all is next.  For arrays of the
          host alone; it has no halo, so that tiles would show.
        - ``icm``: iterated conditional modes (Besag 1986), one class of colour after the other; the simplest, it often
          ends highest.
        - ``annealing``: Gibbs sampler (Geman & Geman 1984) over the same classes at falling temperatures, then
          descent; slow.
        - ``messages``: reweighted messages (Wainwright et al. 2005), then rounds of descent; of labels alone.  It ends
          lowest, with many labels, much noise or weak data above all.
    rounds
        Cap on the rounds of HCF and of descent, and on the sweeps of icm.  Within 24 next to no site of a photograph
        still wants to change.
    annealing
        Schedule of that method.
    messages
        Rounds of messages of that method, on each grid.  After 16 the energy hardly falls where the data are strong.
    scales
        Coarser grids of blocks of 2, 4, 8, … pixels that messages go over first.  0 does for strong data; weak data
        take 3 with 32 rounds.  All of them together cost a third more time; each doubles the halo.
    sure
        Whether HCF starts with line elements of 0 between equal labels.

    Raises
    ------
    ValueError
        For an unknown method, or a number out of its range.

    Examples
    --------
    >>> from tilepipe_kernels.mrf.labels.minimise import halo
    >>> from tilepipe_kernels.mrf.search import Search
    >>> halo(Search(rounds=10)), halo(Search("messages", rounds=10, messages=16))
    (21, 37)
    """

    method: Method = "parallel"
    rounds: int = 24
    annealing: Annealing = field(default_factory=Annealing)
    messages: int = 16
    scales: int = 0
    sure: bool = True

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise ValueError(f"method must be one of {', '.join(get_args(Method))}, not {self.method!r}")
        if not 1 <= self.rounds <= MOST_ROUNDS:
            raise ValueError(f"rounds must be from 1 to {MOST_ROUNDS}, not {self.rounds}")
        if self.messages < 1:
            raise ValueError(f"messages must be 1 round or more, not {self.messages}")
        if not 0 <= self.scales <= LARGEST_SCALES:
            raise ValueError(f"scales must be from 0 to {LARGEST_SCALES} coarser grids, not {self.scales}")


DEFAULT = Search()
