"""Inputs named by URLs, by GDAL's paths and by archives; results only on a local disk."""

from __future__ import annotations

import re
import subprocess
import sys
import time
import urllib.error
import urllib.request
import zipfile
from collections.abc import Iterator
from contextlib import nullcontext
from email.message import Message
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from tests.io.files import range_server
from tests.io.rasters.test_raster import numbers, same, whole, write_raster
from tilepipe.errors import InputError
from tilepipe.io.files.atomic import atomic_write
from tilepipe.io.files.identity import ChangedInputError
from tilepipe.io.files.paths import absolute_name, gdal_name, local_output, location
from tilepipe.io.files.remote import remote_state
from tilepipe.io.rasters.raster import open_raster


@pytest.fixture
def served(tmp_path) -> Iterator[tuple[Path, str]]:
    """A folder and its address."""
    folder = tmp_path / "served"
    folder.mkdir()
    command = [sys.executable, range_server.__file__, str(folder)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        yield folder, f"http://127.0.0.1:{int(server.stdout.readline())}"
        server.terminate()


@pytest.mark.parametrize("kind", [str, Path])
def test_a_raster_on_a_server(served, kind):
    folder, address = served
    write_raster(folder / "a.tif", numbers())
    raster = open_raster([kind(f"{address}/a.tif")])
    assert same(whole(raster), numbers())
    assert raster.names == [f"{address}/a.tif"]
    assert raster.members[0].source.elsewhere == (f"/vsicurl/{address}/a.tif",)
    raster.members[0].source.check()


def test_a_raster_that_is_replaced_on_its_server_is_noticed(served):
    folder, address = served
    write_raster(folder / "a.tif", numbers())
    source = open_raster([f"{address}/a.tif"]).members[0].source
    write_raster(folder / "a.tif", numbers(8, 9))
    with pytest.raises(ChangedInputError, match=r"/a\.tif: has changed"):
        source.check()
    (folder / "a.tif").unlink()
    with pytest.raises(ChangedInputError, match=r"/a\.tif: is gone"):
        source.check()


def test_what_a_server_does_not_have_is_refused_in_a_line(served):
    with pytest.raises(InputError, match=r"/b\.tif: cannot be opened \(.*404.*\); check the address"):
        open_raster([f"{served[1]}/b.tif"])


@pytest.mark.parametrize("address", ["http://127.0.0.1:1/a.tif", "https://nobody.invalid/a.tif"])
def test_a_server_that_is_not_there_is_refused_at_once(address):
    start = time.monotonic()
    with pytest.raises(InputError, match=re.escape(f"{address}: cannot be opened")) as error:
        open_raster([address])
    assert time.monotonic() - start < 20
    assert "\n" not in str(error.value)
    assert "copy" not in str(error.value)


def test_archives(tmp_path, served):
    folder, address = served
    write_raster(tmp_path / "a.tif", numbers())
    with zipfile.ZipFile(folder / "a.zip", "w") as archive:
        archive.write(tmp_path / "a.tif", "inner/a.tif")
        archive.writestr("readme.txt", "")
    for name in (folder / "a.zip", f"/vsizip/{folder / 'a.zip'}/inner/a.tif", f"zip://{folder / 'a.zip'}!inner/a.tif"):
        assert same(whole(open_raster([name])), numbers())
    assert same(whole(open_raster([f"/vsizip//vsicurl/{address}/a.zip/inner/a.tif"])), numbers())
    with zipfile.ZipFile(folder / "a.zip", "a") as archive:
        archive.write(tmp_path / "a.tif", "inner/b.tif")
    with pytest.raises(InputError, match=r"a\.zip: holds 2 rasters; name one, such as /vsizip/.*/inner/a\.tif"):
        open_raster([folder / "a.zip"])


def test_an_archive_of_one_raster_is_that_raster_however_it_is_named(tmp_path):
    path = write_raster(tmp_path / "a.tif", numbers())
    for name in ("one", "two"):
        with zipfile.ZipFile(tmp_path / f"{name}.zip", "w") as archive:
            archive.write(path, "inner/a.tif")
            archive.writestr("readme.txt", "")
            if name == "two":
                archive.write(path, "inner/b.tif")
    one, two = tmp_path / "one.zip", tmp_path / "two.zip"
    for name in (one, f"zip://{one}", f"/vsizip/{one}", f"zip://{two}!/inner/b.tif", f"zip://{two}!inner/b.tif"):
        assert same(whole(open_raster([name])), numbers())


def test_archives_of_anything_else_are_refused_with_what_to_do(tmp_path):
    with zipfile.ZipFile(tmp_path / "empty.zip", "w"):
        pass
    with zipfile.ZipFile(tmp_path / "a.zarr.zip", "w") as archive:
        archive.writestr("a.zarr/zarr.json", "{}")
    (tmp_path / "a.tar.gz").write_bytes(b"packed")
    for name, what in (("empty.zip", "empty archive"), ("a.zarr.zip", "unpack it"), ("a.tar.gz", "unpack it first")):
        with pytest.raises(InputError, match=what):
            open_raster([tmp_path / name])


def test_a_raster_that_only_a_driver_finds_is_to_be_written_out(tmp_path):
    values = xr.DataArray(np.zeros((4, 5)), dims=("y", "x"))
    xr.Dataset({"height": values, "slope": values}).to_netcdf(tmp_path / "a.nc")
    with pytest.raises(InputError, match=r"a\.nc: holds 2 rasters; write one out first: gdal_translate .*height"):
        open_raster([tmp_path / "a.nc"])
    for name in ("NETCDF:a.nc:height", f'NETCDF:"{tmp_path}/a.nc":height', "WMS:http://host"):
        with pytest.raises(InputError, match=f"^{re.escape(name)}: names a part of a file; .* gdal_translate "):
            open_raster([name])


def test_an_address_may_hold_spaces(served):
    folder, address = served
    write_raster(folder / "a b.tif", numbers())
    raster = open_raster([f"{address}/a%20b.tif"])
    assert same(whole(raster), numbers())
    assert raster.members[0].source.is_known
    with pytest.raises(InputError, match="cannot be opened"):
        open_raster([f"{address}/no such.tif"])


def test_addresses_as_gdal_knows_them():
    known = {
        "https://host/a.tif": "/vsicurl/https://host/a.tif",
        "s3://bucket/a.tif": "/vsis3/bucket/a.tif",
        "gs://bucket/a.tif": "/vsigs/bucket/a.tif",
        "az://container/a.tif": "/vsiaz/container/a.tif",
        "/vsis3/bucket/a.tif": "/vsis3/bucket/a.tif",
        "C:/data/a.tif": "C:/data/a.tif",
        "file:///data/a%20b.tif": "/data/a b.tif",
        "file://localhost/data/a.tif": "/data/a.tif",
    }
    assert {name: gdal_name(name) for name in known} == known
    assert location(Path("s3://bucket/a.tif")) == "s3://bucket/a.tif"
    with pytest.raises(InputError, match=r"gopher://host/a\.tif: addresses that begin with gopher: cannot be opened"):
        gdal_name("gopher://host/a.tif")
    with pytest.raises(InputError, match="read more than once"):
        gdal_name("/vsistdin/")


def test_stores_on_servers_need_packages():
    with pytest.raises(InputError, match=r"s3://bucket/a\.zarr: .*s3fs"):
        open_raster(["s3://bucket/a.zarr"])


def test_names_that_hold_from_anywhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.zip").write_bytes(b"")
    assert absolute_name("/vsizip/a.zip/a.tif") == f"/vsizip/{tmp_path}/a.zip/a.tif"
    assert absolute_name("a.zip") == str(tmp_path / "a.zip")
    assert absolute_name("s3://bucket/a.tif") == "s3://bucket/a.tif"


@pytest.mark.parametrize("out", ["s3://bucket/run", "http://host/run", "/vsis3/bucket/run", Path("s3://bucket/run")])
def test_results_go_to_a_local_disk(out, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="results are written to a local disk"):
        local_output(out)
    with pytest.raises(InputError, match="results are written to a local disk"), atomic_write(out):
        pass
    assert not any(tmp_path.iterdir())


def test_only_the_archive_in_a_name_is_made_absolute(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with zipfile.ZipFile("a.zip", "w"):
        pass
    assert absolute_name("/vsizip/a.zip/a.zip/b.tif") == f"/vsizip/{tmp_path}/a.zip/a.zip/b.tif"
    assert absolute_name("/vsizip/gone.zip/b.tif") == "/vsizip/gone.zip/b.tif"


@pytest.mark.parametrize(
    ("answer", "state"),
    [
        (404, (-1, 0, "")),
        (410, (-1, 0, "")),
        (403, (0, 0, "")),
        (500, (0, 0, "")),
        (OSError("no route"), (0, 0, "")),
        ({"Content-Range": "bytes 0-0/17", "Content-Length": "1"}, (17, 0, "")),
        ({"Content-Length": "17", "ETag": "x"}, (17, 0, "x")),
        ({"Content-Range": "bytes 0-0/*"}, (0, 0, "")),
        ({"Content-Length": "1", "Last-Modified": "Thu, 01 Jan 1970 00:00:05 GMT"}, (1, 5_000_000_000, "")),
        ({"Content-Length": "1", "Last-Modified": "yesterday"}, (1, 0, "")),
    ],
)
def test_what_is_known_of_a_file_on_a_server(monkeypatch, answer, state):
    def urlopen(request, timeout):
        assert request.full_url == "https://host/a%20b.tif"
        if isinstance(answer, Exception):
            raise answer
        if isinstance(answer, int):
            raise urllib.error.HTTPError(request.full_url, answer, "", Message(), None)
        return nullcontext(SimpleNamespace(headers=answer))

    monkeypatch.setattr(urllib.request, "urlopen", urlopen)
    assert remote_state("/vsicurl/https://host/a b.tif") == state


class Bucket:
    """What fsspec gives for a bucket."""

    def __init__(self, answer: dict[str, object] | Exception) -> None:
        self.answer = answer
        self.stale = True

    def invalidate_cache(self) -> None:
        self.stale = False

    def info(self, path: str) -> dict[str, object]:
        assert path == "bucket/a.tif" and not self.stale
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


@pytest.mark.parametrize(
    ("answer", "state"),
    [
        (FileNotFoundError(), (-1, 0, "")),
        (PermissionError(), (0, 0, "")),
        ({"size": 17, "ETag": "x", "LastModified": "today"}, (17, 0, "x today")),
        ({"size": 17, "etag": "x", "updated": "today"}, (17, 0, "x today")),
        ({"size": 17, "md5Hash": "x", "last_modified": "today"}, (17, 0, "x today")),
        ({"size": None, "ETag": "x"}, (0, 0, "x")),
        ({"size": 17}, (17, 0, "")),
    ],
)
@pytest.mark.parametrize("name", ["/vsis3/bucket/a.tif", "/vsizip//vsis3/bucket/a.tif"])
def test_what_is_known_of_a_file_in_a_bucket(monkeypatch, name, answer, state):
    asked = []

    def url_to_fs(url):
        asked.append(url)
        return Bucket(answer), url.partition("://")[2]

    monkeypatch.setattr("fsspec.core.url_to_fs", url_to_fs)
    assert remote_state(name) == state
    assert asked == ["s3://bucket/a.tif"]
