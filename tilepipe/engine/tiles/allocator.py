"""How a process of ours gives memory back: it keeps what a tile has freed for the next tile.

Blocks of tens of megabytes are mapped and unmapped anew for each tile otherwise, and the kernel clears every page:
a twentieth of the run time.  One arena for all threads also leaves less behind than one per thread.
"""

from __future__ import annotations

import ctypes

_TRIM_THRESHOLD, _MMAP_MAX, _ARENA_MAX = -1, -4, -8
"""Parameters of mallopt(3)."""

_KEPT = 1 << 30
"""Bytes free at the top of the heap that are kept."""


def keep_freed_memory() -> bool:
    """Set up the C allocator of this process; True where it knows these settings (glibc).

    Called by the command line and by worker processes, which are ours; never by an import, as the settings are the
    whole process's.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError, TypeError):
        return False
    settings = ((_ARENA_MAX, 1), (_MMAP_MAX, 0), (_TRIM_THRESHOLD, _KEPT))
    return all(mallopt(name, value) == 1 for name, value in settings)
