"""Which bands of a raster hold its image: alpha is none of them, and the indices of a palette stand for colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from tilepipe.errors import InputError


@dataclass(frozen=True)
class Bands:
    """The bands of a raster, counted from 1.

    Attributes
    ----------
    image
        All but alpha.
    alpha
        The band of opacity, None without one.
    colours
        Red, green and blue: so called, or the only three bands; None where they are not known.
    tagged
        Whether the colours are so called.
    palettes
        Bands that hold indices of a palette.

    Examples
    --------
    >>> from tilepipe.io.rasters.bands import Bands
    >>> bands = Bands.of(["alpha", "blue", "green", "red"])
    >>> bands.image, bands.alpha, bands.colours
    ((2, 3, 4), 1, (4, 3, 2))
    """

    image: tuple[int, ...]
    alpha: int | None = None
    colours: tuple[int, ...] | None = None
    tagged: bool = False
    palettes: tuple[int, ...] = ()

    @classmethod
    def of(cls, meanings: Sequence[str]) -> Bands:
        """From the meaning of each band in GDAL's words, such as ``red``, ``alpha`` or ``palette``."""
        image = tuple(number for number, meaning in enumerate(meanings, 1) if meaning != "alpha")
        alpha = next((number for number, meaning in enumerate(meanings, 1) if meaning == "alpha"), None)
        palettes = tuple(number for number, meaning in enumerate(meanings, 1) if meaning == "palette")
        if {"red", "green", "blue"} <= set(meanings):
            named = tuple(meanings.index(colour) + 1 for colour in ("red", "green", "blue"))
            return cls(image, alpha, named, True, palettes)
        return cls(image, alpha, image if len(image) == 3 else None, False, palettes)


@dataclass(frozen=True)
class Choice:
    """The bands of every input that are read.

    Attributes
    ----------
    numbers
        Counted from 1; None = the only one.
    colours
        They are red, green and blue: an input that says which of its bands these are, or holds a palette, has them
        from there instead.
    option
        Name of the option by which one of several can be chosen, for messages.
    """

    numbers: tuple[int, ...] | None = None
    colours: bool = False
    option: str = "band"

    def of(self, bands: Bands, name: str) -> tuple[int, ...]:
        """Numbers of the bands to read of one input, called ``name``; of a palette, the band of its indices.

        Raises
        ------
        InputError
            The input has no such band, or several and none is chosen; the band is alpha, or indices of a palette are
            asked for as values.

        Examples
        --------
        >>> from tilepipe.io.rasters.bands import Bands, Choice
        >>> Choice().of(Bands.of(["gray", "alpha"]), "a.tif")
        (1,)
        >>> Choice().of(Bands.of(["red", "green", "blue", "alpha"]), "b.tif")
        Traceback (most recent call last):
            ...
        tilepipe.errors.InputError: b.tif: has 3 bands; choose one with --band n (band=n)
        """
        if self.colours and len(bands.image) == 1 and bands.palettes == bands.image:
            return bands.palettes
        numbers = (bands.colours if self.colours and bands.tagged else None) or self.numbers
        if numbers is None and not bands.image:
            raise InputError(f"{name}: has no band but alpha, which is no image; give one of intensities or heights")
        if numbers is None and len(bands.image) > 1:
            option = f"--{self.option.replace('_', '-')} n ({self.option}=n)"
            raise InputError(f"{name}: has {len(bands.image)} bands; choose one with {option}")
        numbers = numbers or bands.image
        count = max((*bands.image, bands.alpha or 0))
        for number in numbers:
            if not 1 <= number <= count:
                raise InputError(f"{name}: has no band {number}; it has {count}")
            if number not in bands.image:
                others = ", ".join(map(str, bands.image)) or "none"
                raise InputError(f"{name}: its band {number} is alpha, which is no image; choose another ({others})")
            if number in bands.palettes:
                raise InputError(
                    f"{name}: holds indices of a palette of colours, which measure nothing; give the raster that was "
                    "coloured, or one of the bands that gdal_translate -expand rgb makes of it"
                )
        return tuple(numbers)
