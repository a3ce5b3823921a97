"""The errors that a user can mend."""

from __future__ import annotations


class InputError(ValueError):
    """Something the user gave cannot be used; the message says what is wrong and what to do (exit code 2).

    Examples
    --------
    >>> import tilepipe
    >>> tilepipe.open_raster(["missing.tif"])
    Traceback (most recent call last):
        ...
    tilepipe.errors.InputError: missing.tif: no such file; check the path
    """


class MemoryLimitError(InputError):
    """What the finished tiles hold needs more than ``--memory``; they are kept, and a run with more memory goes on."""


class OutputError(InputError):
    """Results cannot be put where the user wants them; they are kept, and the same command goes on when they can."""


class TileError(RuntimeError):
    """A tile of a pass failed; the message names the tile and the cause (exit code 1)."""


class WorkerError(RuntimeError):
    """What was to work on a tile has been lost, or cannot; the message says how."""
