"""What a server tells of a file without sending it: its size, its time of change, its version."""

from __future__ import annotations

import email.utils
import re
import urllib.error
import urllib.parse
import urllib.request
from typing import Any

from tilepipe.io.files.gdal_options import TIMEOUT

_URL = re.compile(r"/vsicurl/((?:https?)://.*)")
_BUCKET = re.compile(r"/vsi(s3|gs|az|oss)/(.*)")
_INSIDE_ARCHIVE = re.compile(r"(.*\.(?:zip|tar|tgz|gz))/.*")


def remote_state(name: str) -> tuple[int, int, str]:
    """Size in bytes, time of change in ns and version of a file, by the name under which GDAL opens it.

    Buckets are asked by fsspec where the package for them is installed (s3fs, gcsfs, adlfs, ossfs).

    Returns
    -------
    tuple
        ``(0, 0, "")`` where nothing can be known; a size of -1 where there is no such file.

    Examples
    --------
    >>> from tilepipe.io.files.remote import remote_state
    >>> remote_state("/vsihdfs/host/a.tif")  # nobody here to ask
    (0, 0, '')
    """
    inside = _INSIDE_ARCHIVE.fullmatch(name)
    file = re.sub(r"^(/vsi(?:zip|tar|gzip)/)+", "", inside[1] if inside and "/vsi" in name[1:] else name)
    if match := _URL.search(file):
        return _asked_of_server(match[1])
    if match := _BUCKET.search(file):
        return _asked_of_bucket(f"{match[1]}://{match[2]}")
    return 0, 0, ""


def _asked_of_server(url: str) -> tuple[int, int, str]:
    # one byte: signed addresses allow no request of another kind, such as HEAD
    # what a browser would encode, such as a space, but nothing twice
    encoded = urllib.parse.quote(url, safe="%/:?#[]@!$&'()*+,;=~")
    request = urllib.request.Request(encoded, headers={"Range": "bytes=0-0"})
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT) as answer:
            headers = answer.headers
    except urllib.error.HTTPError as error:
        if error.code in (404, 410):
            return -1, 0, ""
        return 0, 0, ""
    except (OSError, ValueError):
        return 0, 0, ""
    length = (headers.get("Content-Range") or "").rpartition("/")[2] or headers.get("Content-Length") or ""
    size = int(length) if length.isdigit() else 0
    return size, _time(headers.get("Last-Modified")), headers.get("ETag") or ""


def _time(text: str | None) -> int:
    try:
        return int(email.utils.parsedate_to_datetime(text or "").timestamp()) * 1_000_000_000
    except (TypeError, ValueError):
        return 0


def _asked_of_bucket(url: str) -> tuple[int, int, str]:
    try:
        from fsspec.core import url_to_fs

        system, path = url_to_fs(url)
        system.invalidate_cache()
        found: dict[str, Any] = system.info(path)
    except FileNotFoundError:
        return -1, 0, ""
    except Exception:  # no package for it, no right to ask, no network
        return 0, 0, ""
    changed = found.get("LastModified") or found.get("updated") or found.get("last_modified") or ""
    version = str(found.get("ETag") or found.get("etag") or found.get("md5Hash") or "")
    return int(found.get("size") or 0), 0, f"{version} {changed}".strip()
