"""Rasters that a pipeline takes beside its main ones."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Input:
    """Rasters that a pipeline may take beside its main ones, on the same pixel grid.

    Attributes
    ----------
    name
        Name among the inputs of a record.
    option
        Name of the option of the command line and of the argument in Python.
    meaning
        What it is and what it is for.
    """

    name: str
    option: str
    meaning: str
