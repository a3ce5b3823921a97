"""Coordinate reference systems: understood, compared, and written down so that they stay what they were given as."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from tilepipe.errors import InputError
from tilepipe.io.crs.units import axis_metres

if TYPE_CHECKING:
    from pyproj import CRS
    from pyproj._crs import Axis


def understood_crs(crs: object, name: str) -> CRS:
    """A CRS from anything that pyproj accepts; a name must be that of the CRS, not only like it.

    Parameters
    ----------
    crs
        ``EPSG:n``, WKT, PROJJSON, a PROJ string, a name, or an object of a CRS.
    name
        What names it, for the message.

    Raises
    ------
    InputError
        The CRS is not understood.

    Examples
    --------
    >>> from tilepipe.io.crs.systems import understood_crs
    >>> understood_crs("EPSG:28992", "--crs").name
    'Amersfoort / RD New'
    >>> understood_crs("RD New", "--crs")
    Traceback (most recent call last):
        ...
    tilepipe.errors.InputError: --crs: CRS 'RD New' is not understood; pass --crs EPSG:n
    """
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    text = " ".join(str(crs).split())
    shown = text if len(text) <= 80 else f"{text[:77]}..."
    try:
        found = CRS.from_user_input(_whole(crs))
    except CRSError as error:
        raise InputError(f"{name}: CRS '{shown}' is not understood; pass --crs EPSG:n") from error
    # PROJ takes a name for the likeliest of those that are like it
    is_name = isinstance(crs, str) and not text.isdigit() and not set(text) & set(":[{=")
    if is_name and found.name.casefold() != text.casefold():
        raise InputError(f"{name}: no CRS is named '{shown}' ({found.name} is likest); pass --crs EPSG:n")
    return registered_crs(found)


def _whole(crs: Any) -> Any:
    """A CRS of rasterio as WKT 2, since its default is an old WKT that does not hold everything; others as they are."""
    return crs.to_wkt(version="WKT2_2019") if type(crs).__module__.partition(".")[0] == "rasterio" else crs


def registered_crs(crs: CRS) -> CRS:
    """A CRS as PROJ here has it under its code, where GDAL, by its own copy of the registry, describes it otherwise.

    Releases of the EPSG registry rename datums, and rasterio and pyproj need not bring the same one.

    Examples
    --------
    Since release 12 of the registry the datum of the Finnish grid has a name of its own.

    >>> from pyproj import CRS
    >>> import rasterio.crs
    >>> from tilepipe.io.crs.systems import registered_crs
    >>> wkt = rasterio.crs.CRS.from_epsg(3067).to_wkt(version="WKT2_2019")
    >>> registered_crs(CRS(wkt)) == CRS("EPSG:3067")
    True
    """
    import pyproj

    code = crs.to_json_dict().get("id", {})
    if crs.is_bound or set(code) != {"authority", "code"} or crs.to_authority(min_confidence=100):
        return crs
    import rasterio.crs
    from rasterio.errors import CRSError

    authority, number = str(code["authority"]), str(code["code"])
    try:
        described = rasterio.crs.CRS.from_authority(authority, number).to_wkt(version="WKT2_2019")
        return pyproj.CRS.from_authority(authority, number) if crs.equals(pyproj.CRS(described)) else crs
    except (CRSError, pyproj.exceptions.CRSError):
        return crs


def crs_of_dataset(dataset: Any) -> CRS | None:
    """CRS of an open dataset of rasterio, from its own file or the one beside it; None where it has none.

    Raises
    ------
    InputError
        PROJ does not understand it.

    Examples
    --------
    >>> import rasterio
    >>> from tilepipe.io.crs.systems import crs_of_dataset
    >>> from tilepipe.synthetic import City, write_city
    >>> written = write_city(".", City(rows=64, columns=64), layers=["height"], truth=False)
    >>> with rasterio.open(written["height"]) as dataset:
    ...     crs_of_dataset(dataset).to_epsg()
    32633
    """
    return understood_crs(dataset.crs, str(dataset.name)) if dataset.crs else None


def crs_text(crs: CRS) -> str:
    """A CRS as text that gives the very same one: ``EPSG:n`` where that is it exactly, else WKT 2.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.crs.systems import crs_text
    >>> crs_text(CRS(CRS("EPSG:28992").to_wkt()))
    'EPSG:28992'
    >>> crs_text(CRS("+proj=utm +zone=33 +ellps=GRS80"))[:23]  # no datum, so it is not EPSG:25833
    'PROJCRS["unknown",BASEG'
    """
    authority = None if crs.is_bound else crs.to_authority(min_confidence=100)
    return ":".join(authority) if authority else crs.to_wkt("WKT2_2019")


def same_crs(a: CRS, b: CRS) -> bool:
    """Whether two CRS are the same, whatever they are called and whichever coordinate they name first.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.crs.systems import same_crs
    >>> same_crs(CRS("EPSG:31467"), CRS("EPSG:5677"))  # of the same map, the second names east first
    True
    >>> same_crs(CRS("EPSG:31467"), CRS("+proj=tmerc +lon_0=9 +x_0=3500000 +ellps=bessel"))  # no datum
    False
    """
    return bool(a.equals(b, ignore_axis_order=True)) or bool(_east_first(a).equals(_east_first(b), True))


def agreed_crs(a: CRS, b: CRS) -> CRS | None:
    """The CRS that two name, None where they differ; if only one says how to get to WGS 84, that one.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.crs.systems import agreed_crs
    >>> text = CRS("EPSG:31467").to_wkt("WKT1_GDAL")  # DHDN / 3-degree Gauss-Kruger zone 3
    >>> bound = CRS(text.replace("],PRIMEM", ",TOWGS84[598.1,73.7,418.2,0,0,0,0]],PRIMEM"))
    >>> agreed_crs(CRS(text), bound).type_name
    'Bound CRS'
    >>> agreed_crs(bound, CRS(bound.to_wkt().replace("598.1", "582")))
    """
    if same_crs(a, b):
        return a
    if a.is_bound == b.is_bound:
        return None
    bound, plain = (a, b) if a.is_bound else (b, a)
    return bound if same_crs(unbound_crs(bound), plain) else None


def unbound_crs(crs: CRS) -> CRS:
    """A CRS without the way to another one that it may name: its map is the same.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.crs.systems import unbound_crs
    >>> unbound_crs(CRS("+proj=utm +zone=31 +ellps=intl +towgs84=-87,-98,-121")).type_name
    'Projected CRS'
    """
    return crs.source_crs if crs.is_bound and crs.source_crs is not None else crs


def _east_first(crs: CRS) -> CRS:
    """A CRS whose axes, if these are east and north, stand in this order, as coordinates in files do."""
    import pyproj

    described = crs.to_json_dict()
    axes = described.get("source_crs", described).get("coordinate_system", {}).get("axis", [])
    if [axis.get("direction") for axis in axes] != ["north", "east"]:
        return crs
    axes.reverse()
    return pyproj.CRS.from_json_dict(described)


def split_crs(crs: CRS) -> tuple[CRS, Axis | None]:
    """Horizontal part of a CRS, and its vertical axis (None without one).

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.crs.systems import split_crs
    >>> horizontal, vertical = split_crs(CRS("EPSG:7415"))  # Amersfoort / RD New + NAP height
    >>> horizontal.to_epsg(), vertical.unit_name
    (28992, 'metre')
    """
    vertical = _vertical_axis(crs)
    return (crs, None) if vertical is None and not crs.is_compound else (crs.to_2d(), vertical)


def _vertical_axis(crs: CRS) -> Axis | None:
    plain = unbound_crs(crs)
    if plain.is_compound:
        axes = unbound_crs(plain.sub_crs_list[1]).axis_info
        return axes[0] if axes else None
    return plain.axis_info[2] if not plain.is_geocentric and len(plain.axis_info) == 3 else None


def map_unit(crs: CRS) -> float:
    """Length in metres of the unit of a map's coordinates; 1 where the CRS names none.

    Raises
    ------
    InputError
        The unit has no length.

    Examples
    --------
    >>> from pyproj import CRS
    >>> from tilepipe.io.crs.systems import map_unit
    >>> map_unit(CRS("EPSG:32633")), round(map_unit(CRS("EPSG:2263")), 6)  # metres, US survey feet
    (1.0, 0.304801)
    """
    axes = unbound_crs(crs).axis_info
    return axis_metres(axes[0]) if axes else 1.0


def check_named_crs(name: str, named: CRS, given: CRS) -> CRS:
    """The horizontal CRS that a source names, which must be the one that the user gives.

    Raises
    ------
    InputError
        Names the source and both CRS.
    """
    agreed = agreed_crs(named, given)
    if agreed is None:
        alike = " otherwise defined" if named.name == given.name else ""
        raise InputError(
            f"{name}: is in {named.name} but --crs names {given.name}{alike}; --crs is for inputs that name no CRS: "
            "leave it out, or correct the file if what it names is wrong"
        )
    return agreed
