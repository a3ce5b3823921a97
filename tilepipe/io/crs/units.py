"""Units of length by the names that rasters, point clouds and coordinate reference systems give them."""

from __future__ import annotations

import re
from functools import cache
from typing import TYPE_CHECKING

from tilepipe.errors import InputError

if TYPE_CHECKING:
    from pyproj._crs import Axis

SOME_UNITS = "m, dm, cm, mm, km, foot, US survey foot, yard, inch, or the EPSG name of another length"
"""What messages say of the names that are known."""

_SAME_UNIT = 1e-9
"""Largest relative difference of two spellings of one unit."""

_PREFIXES = {
    "kilo": ("k", 1e3),
    "hecto": ("h", 1e2),
    "deca": ("da", 1e1),
    "": ("", 1.0),
    "deci": ("d", 1e-1),
    "centi": ("c", 1e-2),
    "milli": ("m", 1e-3),
    "micro": ("u", 1e-6),
}
"""SI prefixes that occur with lengths: symbol and factor."""

_SYMBOLS = {f"{symbol}m": factor for symbol, factor in _PREFIXES.values()}
"""Lengths of metres with their prefixes by symbol: in small letters or in capitals, for Mm is the megametre."""

_WORDS = {
    "ft": "foot",
    "feet": "foot",
    "yd": "yard",
    "in": "inch",
    "inches": "inch",
    "mi": "mile",
    "ch": "chain",
    "li": "link",
    "lk": "link",
    "fath": "fathom",
    "fth": "fathom",
    "usa": "us",
    "nmi": "nautical mile",
    "kmi": "nautical mile",
    "ftus": "foot us",
    "usft": "foot us",
    "ussft": "foot us",
    "sft": "foot us",
    "sfoot": "foot us",
    "sfeet": "foot us",
    "clarkes": "clarke",
}
"""Words and symbols of UCUM, UDUNITS, ESRI, GDAL and PROJ, and the plain words for them."""

_SAID_ANYWAY = {"i", "int", "intl", "international", "statute", "survey"}
"""Words that tell no unit from another: feet and miles are international ones, those of the survey are of the US."""

_HEIGHTS = re.compile(r"\b(above|asl|amsl)\b.*", re.IGNORECASE)
_MULTIPLE = re.compile(r"([0-9]+(?:\.[0-9]+)?(?:e[+-]?[0-9]+)?)\s*\*?\s*([a-z].*)", re.IGNORECASE)


def unit_metres(unit: str | None) -> float | None:
    """Length in metres of a unit by name; None where it is no known length.

    Known are metres with their prefixes and all lengths of EPSG, in the spellings of UCUM, UDUNITS, ESRI, GDAL and
    PROJ, in singular and plural, in any case of letters but of the symbols of metres, and multiples such as ``0.1 m``.

    Examples
    --------
    >>> from tilepipe.io.crs.units import unit_metres
    >>> [unit_metres(unit) for unit in ("metres", "dm", "ft", "[ft_i]", "British foot (1936)")]
    [1.0, 0.1, 0.3048, 0.3048, 0.3048007491]
    >>> {unit_metres(unit) for unit in ("U.S. Survey Feet", "Foot_US", "ftUS", "US survey foot")} == {1200 / 3937}
    True
    >>> unit_metres("furlongs per fortnight") is unit_metres("dBZ") is None
    True
    """
    text = re.sub("a\\.s\\.l", "asl", (unit or "").replace("µ", "u").replace("μ", "u"), flags=re.IGNORECASE)
    text = _HEIGHTS.sub("", text).strip()
    known = _known().get(_key(text))
    if known is None and (multiple := _MULTIPLE.fullmatch(text)):
        of = unit_metres(multiple[2])
        known = None if of is None else float(multiple[1]) * of
    return known or None


def unit_name(axis: Axis) -> str:
    """Name of the unit of an axis by which `unit_metres` knows its length.

    Raises
    ------
    InputError
        The unit has no length.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.crs.units import unit_name
    >>> unit_name(CRS("EPSG:6360").axis_info[0])  # NAVD88 height (ftUS)
    'US survey foot'
    """
    name, metres = str(axis.unit_name), axis_metres(axis)
    by_name = unit_metres(name)
    if by_name is not None and same_unit(by_name, metres):
        return name
    return next((known for known, length in _lengths().items() if same_unit(length, metres)), f"{metres!r} m")


def axis_metres(axis: Axis) -> float:
    """Length in metres of the unit of an axis of a coordinate reference system.

    Raises
    ------
    InputError
        The unit has no length.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.crs.units import axis_metres
    >>> axis_metres(CRS("EPSG:2222").axis_info[0])  # NAD83 / Arizona East (ft)
    0.3048
    """
    metres = float(axis.unit_conversion_factor)
    if not 0 < metres < float("inf"):
        raise InputError(f"the CRS counts in '{axis.unit_name}', which has no length; give a CRS with a known unit")
    return metres


def epsg_unit(code: int) -> str | None:
    """EPSG's name of a unit of length by its code; None where it has none.

    Examples
    --------
    >>> from tilepipe.io.crs.units import epsg_unit
    >>> epsg_unit(9003), epsg_unit(9102)  # the second is the degree
    ('US survey foot', None)
    """
    from pyproj.database import get_units_map

    units = get_units_map("EPSG", "linear").values()
    return next((unit.name for unit in units if unit.code == str(code)), None)


def same_unit(a: float, b: float) -> bool:
    """Whether two units have the same length, but for rounding.

    Examples
    --------
    >>> from tilepipe.io.crs.units import same_unit
    >>> same_unit(0.3048, 0.30480000001), same_unit(0.3048, 1200 / 3937)  # the US survey foot is another one
    (True, False)
    """
    return abs(a - b) <= _SAME_UNIT * a


def _key(text: str) -> frozenset[str]:
    """A name in any spelling as its plain words; empty for what is no name."""
    bare = re.sub(r"[.']", "", text)
    if any(word.lower() in _SYMBOLS and word not in (word.lower(), word.upper()) for word in _split(bare)):
        return frozenset()
    bare = bare.lower()
    if not re.fullmatch(r"[a-z0-9\s_\-()\[\]]*", bare):
        return frozenset()
    words = [re.sub(r"met(er|re)s?$", "metre", word) for word in _split(bare)]
    plain = " ".join(_WORDS.get(word, _WORDS.get(word.removesuffix("s"), word)) for word in words).split()
    told = {re.sub(r"^(foot|yard|inch|mile|chain|link|fathom)s$", r"\1", word) for word in plain}
    if "survey" in told:
        told.add("us")
    return frozenset(told - _SAID_ANYWAY)


def _split(name: str) -> list[str]:
    return [word for word in re.split(r"[\s_\-()\[\]]+", name) if word]


@cache
def _lengths() -> dict[str, float]:
    """Lengths of units by name: metres with their prefixes, the foot of the US as it is defined, and what EPSG has."""
    from pyproj.database import get_units_map

    metric = {f"{prefix}metre": factor for prefix, (_, factor) in _PREFIXES.items()}
    ours = {"metre": 1.0, "foot": 0.3048, "US survey foot": 1200 / 3937, "inch": 0.0254, "US survey inch": 100 / 3937}
    # those of PROJ are left out: its decimetre has a centimetre
    epsg = {unit.name: float(unit.conv_factor) for unit in get_units_map("EPSG", "linear").values()}
    return metric | epsg | ours


@cache
def _known() -> dict[frozenset[str], float]:
    """Lengths of units by the words of their names, and by the symbols of metres."""
    names = {_key(name.lower()): length for name, length in _lengths().items()}
    return names | {frozenset({symbol}): factor for symbol, factor in _SYMBOLS.items()}
