"""Rasters that a pipeline takes beside its main ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from tilepipe.errors import InputError


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
    heights
        Whether its values are heights: their unit must then be a known length.
    """

    name: str
    option: str
    meaning: str
    heights: bool = False

    @property
    def band_option(self) -> str:
        """Name of the option, of the argument and among the inputs of a record, that chooses one of several bands.

        Examples
        --------
        >>> from tilepipe.engine.inputs import Input
        >>> Input("heights", "height", "Height raster.").band_option
        'height_band'
        """
        return f"{self.option}_band"


@dataclass(frozen=True)
class Given:
    """What a user has given for an input: one or many paths or arrays, and the band to use where they have several."""

    declared: Input
    rasters: list[Any]
    band: int | None


def as_list(items: Any) -> list[Any]:
    """One or many inputs as a list."""
    return list(items) if isinstance(items, (list, tuple)) else [items]


def given_inputs(declared: Sequence[Input], values: Mapping[str, Any]) -> dict[str, Given]:
    """Inputs that are given, by name, of values by the names of inputs and of their options of bands.

    Raises
    ------
    InputError
        A band of an input is chosen that is not given.

    Examples
    --------
    >>> from tilepipe.engine.inputs import Input, given_inputs
    >>> height = Input("heights", "height", "Height raster.")
    >>> given_inputs([height], {"heights": "dsm.tif", "height_band": 2})["heights"].band
    2
    """
    given: dict[str, Given] = {}
    for item in declared:
        rasters, band = values.get(item.name), values.get(item.band_option)
        if rasters is not None and as_list(rasters):
            given[item.name] = Given(item, as_list(rasters), band)
        elif band is not None:
            option = item.option.replace("_", "-")
            raise InputError(f"--{option}-band chooses a band of --{option}; give that too, or leave it out")
    return given
