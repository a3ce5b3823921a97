"""Names of inputs and outputs as users give them: local paths, URLs, GDAL's ``/vsi`` paths, archives."""

from __future__ import annotations

import os
import re
import zipfile
from pathlib import Path
from urllib.parse import unquote

from tilepipe.errors import InputError

# one letter would be a drive; a Path has made one slash of two
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.\-]+):/+")

_FILE_SYSTEMS = {
    "http": "/vsicurl/http://",
    "https": "/vsicurl/https://",
    "ftp": "/vsicurl/ftp://",
    "s3": "/vsis3/",
    "gs": "/vsigs/",
    "gcs": "/vsigs/",
    "az": "/vsiaz/",
    "oss": "/vsioss/",
    "zip": "/vsizip/",
}
"""GDAL's file system for the scheme of a URL (https://gdal.org/en/stable/user/virtual_file_systems.html)."""

_REMOTE = re.compile(r"/vsi(curl|s3|gs|az|adls|oss|swift|hdfs|webhdfs)(_streaming)?[/?]")

_ARCHIVE = re.compile(r"/vsi(zip|7z|rar|tar|gzip|sparse)/")

OF_A_STORE = ("zarr.json", ".zarray", ".zgroup")
"""Names of the files that describe a Zarr store and each array in it, and that nothing else has."""

SIDE = ".aux.xml"
"""What follows the name of a raster in that of the file beside it."""

_MEMBERS = 3
"""Members of an archive that a message names."""


def location(item: str | os.PathLike[str]) -> str:
    """An input as its user has written it: a URL keeps its slashes, ``file:`` becomes a local path.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.paths import location
    >>> location(Path("https://host/a.tif")), location("file:///data/a.tif"), location("data/a.tif")
    ('https://host/a.tif', '/data/a.tif', 'data/a.tif')
    """
    text = os.fspath(item)
    match = _SCHEME.match(text)
    if match is None:
        return text if text.startswith("/vsi") else str(Path(text))
    scheme, rest = match[1].lower(), text[match.end() :]
    if scheme == "file":
        return "/" + unquote(rest.removeprefix("localhost/"))
    # an absolute path may follow where the scheme names no host
    return f"{match[1]}://{'/' if scheme == 'zip' and match[0].endswith('///') else ''}{rest}"


def is_local(item: str | os.PathLike[str]) -> bool:
    """Whether an input is a path of this machine's file system.

    Examples
    --------
    >>> from tilepipe.io.files.paths import is_local
    >>> is_local("data/a.tif"), is_local("s3://bucket/a.tif"), is_local("/vsizip/a.zip/a.tif")
    (True, False, False)
    """
    text = location(item)
    return _SCHEME.match(text) is None and not text.startswith("/vsi")


def elsewhere(item: str | os.PathLike[str]) -> str:
    """Where something lies that is no path of this machine's file system, and what makes it one, for messages.

    Examples
    --------
    >>> from tilepipe.io.files.paths import elsewhere
    >>> elsewhere("https://host/a.gpkg")
    'lies on a server; download it first'
    >>> elsewhere("/vsizip/a.zip/a.gpkg")
    'lies in an archive; unpack it first'
    """
    text = location(item)
    if text.lower().startswith("zip:") or (_ARCHIVE.match(text) and not is_remote(text)):
        return "lies in an archive; unpack it first"
    return "lies on a server; download it first" if is_remote(text) else "is no file; write it to one first"


def is_of_driver(item: str | os.PathLike[str]) -> bool:
    """Whether a name is no path but one that only a driver of GDAL understands.

    Examples
    --------
    >>> from tilepipe.io.files.paths import is_of_driver
    >>> is_of_driver('NETCDF:"a.nc":height'), is_of_driver("s3:/bucket/a.tif"), is_of_driver("C:/a.tif")
    (True, False, False)
    """
    text = os.fspath(item)
    prefix = re.match(r"([A-Za-z][A-Za-z0-9_]+):(?!//)", text)
    return prefix is not None and prefix[1].lower() not in ("file", *_FILE_SYSTEMS) and not os.path.exists(text)


def gdal_name(item: str | os.PathLike[str]) -> str:
    """The name under which GDAL opens an input.

    Raises
    ------
    InputError
        When GDAL has no file system for the URL, or an archive holds several files.

    Examples
    --------
    >>> from tilepipe.io.files.paths import gdal_name
    >>> gdal_name("https://host/a.tif"), gdal_name("s3://bucket/a.zip"), gdal_name("a.tif")
    ('/vsicurl/https://host/a.tif', '/vsizip//vsis3/bucket/a.zip', 'a.tif')
    """
    text = location(item)
    if text.startswith("/vsistdin"):
        raise InputError(f"{text}: a raster is read more than once; write it to a file first")
    match = _SCHEME.match(text)
    if match is not None:
        scheme = match[1].lower()
        if scheme not in _FILE_SYSTEMS:
            known = ", ".join(sorted(_FILE_SYSTEMS))
            raise InputError(f"{text}: addresses that begin with {scheme}: cannot be opened; known are {known}")
        rest = text[match.end() :] if scheme != "zip" else re.sub("!/?", "/", text[len("zip://") :])
        text = _FILE_SYSTEMS[scheme] + rest
    archive = text.removeprefix("/vsizip/")
    if archive.lower().endswith(".zip"):
        return f"/vsizip/{archive}{_only_member(archive)}"
    return text


def _only_member(archive: str) -> str:
    """What to add to the name of an archive of this machine that holds one raster beside other files."""
    if archive.startswith("/vsi") or not os.path.isfile(archive):
        return ""
    try:
        with zipfile.ZipFile(archive) as file:
            names = [name for name in file.namelist() if not name.endswith("/")]
    except zipfile.BadZipFile as error:
        raise InputError(f"{archive}: is no ZIP archive, or is damaged ({error}); unpack or pack it anew") from None
    if not names:
        raise InputError(f"{archive}: is an empty archive; pack it anew")
    if any(name.endswith(OF_A_STORE) for name in names):
        raise InputError(f"{archive}: holds a Zarr store, which is not read in an archive; unpack it, name its folder")
    rasters = [name for name in names if name.lower().endswith((".tif", ".tiff", ".vrt"))] if len(names) > 1 else names
    if len(rasters) != 1:
        several = ", ".join(f"/vsizip/{archive}/{name}" for name in (rasters or names)[:_MEMBERS])
        raise InputError(f"{archive}: holds {len(rasters) or 'no'} rasters; name one, such as {several}")
    return f"/{rasters[0]}"


def is_remote(name: str) -> bool:
    """Whether GDAL reads a name of its own from the network.

    Examples
    --------
    >>> from tilepipe.io.files.paths import is_remote
    >>> is_remote("/vsizip//vsicurl/https://host/a.zip/a.tif"), is_remote("/vsizip/a.zip/a.tif")
    (True, False)
    """
    return _REMOTE.search(name) is not None or _SCHEME.match(name) is not None


def file_of(name: str) -> str | None:
    """The file of this machine that holds what GDAL knows by a name: the archive of a member; None where none does.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.paths import file_of
    >>> _ = Path("a.zip").write_bytes(b"")
    >>> file_of("/vsizip/a.zip/folder/a.tif"), file_of("a.tif"), file_of("/vsis3/bucket/a.tif")
    ('a.zip', 'a.tif', None)
    """
    if is_remote(name):
        return None
    if not name.startswith("/vsi"):
        return name
    if not _ARCHIVE.match(name):
        return None
    inner = _ARCHIVE.sub("", name)
    while inner.startswith("/vsi") and _ARCHIVE.match(inner):
        inner = _ARCHIVE.sub("", inner, count=1)
    inner = inner.removeprefix("{").replace("}", "")
    path = Path(inner)
    return next((str(each) for each in (path, *path.parents) if each.is_file()), inner)


def absolute_name(item: str | os.PathLike[str]) -> str:
    """An input as it can be found from anywhere; a URL, and what is no path, as it is.

    Examples
    --------
    >>> from tilepipe.io.files.paths import absolute_name
    >>> absolute_name("https://host/a.tif"), absolute_name("the array")
    ('https://host/a.tif', 'the array')
    """
    name = location(item)
    if is_local(name):
        return str(Path(name).absolute()) if os.path.exists(name) else name
    file = file_of(name)
    if file is None or not os.path.exists(file):
        return name
    return name.replace(file, str(Path(file).absolute()), 1)


def local_output(out: str | os.PathLike[str]) -> Path:
    """The path of a result, which is written to this machine's file system.

    Raises
    ------
    InputError
        For a URL or a ``/vsi`` path.

    Examples
    --------
    >>> from tilepipe.io.files.paths import local_output
    >>> str(local_output("runs/first"))
    'runs/first'
    >>> local_output("s3://bucket/first")
    Traceback (most recent call last):
        ...
    tilepipe.errors.InputError: s3://bucket/first: results are written to a local disk; name a local path here
    """
    if not is_local(out):
        raise InputError(f"{location(out)}: results are written to a local disk; name a local path here")
    return Path(location(out))


def one_line(error: Exception) -> str:
    """The beginning of an error of another library, to be quoted in a message."""
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)


def side_file(raster: Path) -> Path:
    """Path of the file beside a raster, which need not exist.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tilepipe.io.files.paths import side_file
    >>> side_file(Path("streets.tif")).name
    'streets.tif.aux.xml'
    """
    return raster.with_name(raster.name + SIDE)
