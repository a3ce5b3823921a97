"""What stands behind a VRT: the files that GDAL reads for it, through any number of VRTs."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

from tilepipe.errors import InputError
from tilepipe.io.files.paths import file_of, is_remote
from tilepipe.tiling.grid import Window

_HEAD = 4096
"""Bytes at the beginning of a file in which a VRT shows itself."""

_DRIVER_PREFIX = re.compile(r"[A-Za-z][A-Za-z0-9_]+:")
"""What a name that only one of GDAL's drivers understands begins with, such as ``NETCDF:"a.nc":height``."""


@dataclass(frozen=True)
class Behind:
    """A file that GDAL reads for a VRT.

    Attributes
    ----------
    name
        As GDAL opens it.
    window
        Pixels of the outermost VRT that it fills; None where only GDAL knows.
    raw
        Whether its bytes are taken as pixels, whatever the file is.
    """

    name: str
    window: Window | None
    raw: bool = False


def vrt_text(path: str) -> str | None:
    """Text of a file of this machine if it is a VRT, else None."""
    try:
        with open(path, "rb") as file:
            head = file.read(_HEAD)
            if b"<VRTDataset" not in head:
                return None
            return (head + file.read()).decode("utf-8", "replace")
    except OSError:
        return None


def files_behind(name: str, text: str) -> list[Behind]:
    """Files behind a VRT, each once for each place where it stands, nested VRTs before their own sources.

    Parameters
    ----------
    name
        Of the VRT, as GDAL opens it; relative names in it start from its folder.
    text
        Its XML.

    Raises
    ------
    InputError
        When it is no XML, when a file behind it is missing, or when it computes pixels by Python code.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.rasters.sources.vrt import files_behind
    >>> _ = Path("a.tif").write_bytes(b"")
    >>> source = "<SimpleSource><SourceFilename relativeToVRT='1'>a.tif</SourceFilename></SimpleSource>"
    >>> text = f"<VRTDataset><VRTRasterBand>{source}</VRTRasterBand></VRTDataset>"
    >>> [each.name for each in files_behind("mosaic.vrt", text)]
    ['a.tif']
    """
    return list(dict.fromkeys(_walk(name, text, None, (name,), outermost=True)))


def _walk(name: str, text: str, window: Window | None, within: tuple[str, ...], *, outermost: bool) -> Iterator[Behind]:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"{name}: is no valid VRT ({error}); make it anew with gdalbuildvrt") from None
    if _runs_python(root):
        raise InputError(
            f"{name}: computes pixels by Python code, which is not run; write the raster out with gdal_translate first"
        )
    for element, raw, place in _named(root, raw=False, place=None):
        named = (element.text or "").strip()
        covered = place if outermost else window
        if "<VRTDataset" in named:
            yield from _walk(name, named, covered, within, outermost=False)
            continue
        inner = _resolved(name, named, relative=_attribute(element, "relativetovrt") in ("1", "true", "yes"))
        yield from _followed(name, inner, covered, raw, within)


def _followed(name: str, inner: str, window: Window | None, raw: bool, within: tuple[str, ...]) -> Iterator[Behind]:
    """A file that a VRT names, and what is behind it in turn."""
    if inner in within:
        raise InputError(f"{name}: names itself, by way of {inner}; make it anew with gdalbuildvrt")
    file = file_of(inner)
    known_by_driver = file is None or (_DRIVER_PREFIX.match(inner) is not None and not os.path.exists(inner))
    if not known_by_driver and not os.path.exists(str(file)):
        raise InputError(f"{within[0]}: {'' if name == within[0] else f'{name} in it: '}its source {inner} is missing")
    yield Behind(inner, window, raw)
    text = None if known_by_driver or raw or inner != file else vrt_text(inner)
    if text is not None:
        yield from _walk(inner, text, window, (*within, inner), outermost=False)


def _named(
    element: ElementTree.Element, raw: bool, place: Window | None
) -> Iterator[tuple[ElementTree.Element, bool, Window | None]]:
    """Elements that name files, whether raw, and the pixels of this VRT that they fill."""
    raw = raw or _attribute(element, "subclass") == "vrtrawrasterband"
    for child in element:
        tag = child.tag.lower()
        # overviews are never read at full resolution
        if tag == "overview":
            continue
        if tag in ("sourcefilename", "sourcedataset"):
            yield child, raw, place
        else:
            yield from _named(child, raw, _destination(child) or place)


def _destination(source: ElementTree.Element) -> Window | None:
    """Pixels that a source fills, with one more around where resampling may reach."""
    rect = next((child for child in source if child.tag.lower() == "dstrect"), None)
    if rect is None:
        return None
    try:
        left, top, width, height = (float(_attribute(rect, name)) for name in ("xoff", "yoff", "xsize", "ysize"))
    except ValueError:
        return None
    rows = math.floor(top) - 1, math.ceil(top + height) + 1
    columns = math.floor(left) - 1, math.ceil(left + width) + 1
    return Window(rows[0], columns[0], rows[1], columns[1])


def _attribute(element: ElementTree.Element, name: str) -> str:
    """Value of an attribute in lower case; GDAL does not tell upper from lower case in names."""
    return next((value.strip().lower() for key, value in element.attrib.items() if key.lower() == name), "")


def _runs_python(root: ElementTree.Element) -> bool:
    return any(
        element.tag.lower() == "pixelfunctionlanguage" and (element.text or "").strip().lower() == "python"
        for element in root.iter()
    )


def _resolved(vrt: str, named: str, *, relative: bool) -> str:
    """Name of a source as GDAL opens it."""
    if named.startswith("vrt://"):
        named = named.removeprefix("vrt://").partition("?")[0]
    if named.startswith(("http://", "https://", "ftp://")):
        return f"/vsicurl/{named}"
    if not relative or named.startswith("/vsi") or os.path.isabs(named):
        return named
    folder, slash, _ = vrt.rpartition("/")
    if slash:
        joined = f"{folder}/{named}"
        return joined if is_remote(joined) or joined.startswith("/vsi") else os.path.normpath(joined)
    return os.path.join(os.path.dirname(vrt), named)
