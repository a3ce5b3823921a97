"""Options of GDAL under which all inputs are opened and read, whatever the environment says."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import rasterio

_ALWAYS = {
    # a VRT may hold Python code; a raster is data and runs none
    "GDAL_VRT_ENABLE_PYTHON": "NO",
    # what a closed handle has fetched may have changed when the next one opens
    "CPL_VSIL_CURL_NON_CACHED": ":".join(
        f"/vsi{kind}/" for kind in ("curl", "s3", "gs", "az", "adls", "oss", "swift", "webhdfs")
    ),
}

_UNLESS_CHOSEN = {
    # seconds; GDAL itself would wait for minutes, or for ever
    "GDAL_HTTP_CONNECTTIMEOUT": "10",
    "GDAL_HTTP_LOW_SPEED_TIME": "30",
    "GDAL_HTTP_LOW_SPEED_LIMIT": "1",
}
"""A server that does not answer, or stops in the middle, is given up."""

TIMEOUT = 10.0
"""Seconds that a question to a server may take."""


def input_options() -> rasterio.Env:
    """Context in which GDAL opens and reads inputs; options hold for the thread that enters it.

    Examples
    --------
    >>> from rasterio.env import getenv
    >>> from tilepipe.io.files.gdal_options import input_options
    >>> with input_options():
    ...     getenv()["GDAL_VRT_ENABLE_PYTHON"]
    'NO'
    """
    import rasterio
    from rasterio.env import getenv, hasenv

    chosen: dict[str, Any] = {**os.environ, **(getenv() if hasenv() else {})}
    return rasterio.Env(**_ALWAYS, **{name: value for name, value in _UNLESS_CHOSEN.items() if name not in chosen})
