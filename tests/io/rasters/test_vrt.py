"""What is behind a VRT is known: nested, relative, warped, raw, on the network, missing, computed by Python."""

from __future__ import annotations

import html
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tests.io.rasters.test_raster import LEFT, TOP, numbers, same, whole, write_raster
from tilepipe.errors import InputError
from tilepipe.io.files.identity import ChangedInputError
from tilepipe.io.rasters.raster import open_raster
from tilepipe.io.rasters.sources.vrt import Behind, files_behind
from tilepipe.tiling.grid import Window

RAW = (
    '<VRTRasterBand dataType="Byte" band="1" subClass="VRTRawRasterBand">'
    '<SourceFilename relativeToVRT="1">{}</SourceFilename>'
    "<ImageOffset>0</ImageOffset><PixelOffset>1</PixelOffset><LineOffset>9</LineOffset></VRTRasterBand>"
)
PYTHON = (
    '<VRTRasterBand dataType="Float32" band="1" subClass="VRTDerivedRasterBand">'
    "<PixelFunctionType>code</PixelFunctionType><PixelFunctionLanguage>{}</PixelFunctionLanguage>"
    "<PixelFunctionCode><![CDATA[\nimport pathlib\npathlib.Path({!r}).write_text('ran')\n"
    "def code(*arguments):\n    pass\n]]></PixelFunctionCode></VRTRasterBand>"
)


def dataset(bands: str, shape: tuple[int, int] = (7, 9)) -> str:
    return (
        f'<VRTDataset rasterXSize="{shape[1]}" rasterYSize="{shape[0]}"><SRS>EPSG:32633</SRS>'
        f"<GeoTransform>{LEFT}, 1, 0, {TOP}, 0, -1</GeoTransform>{bands}</VRTDataset>"
    )


def band(*sources: str) -> str:
    return f'<VRTRasterBand dataType="Float32" band="1">{"".join(sources)}</VRTRasterBand>'


def simple(name: str, column: int = 0, *, relative: bool = True) -> str:
    return (
        f'<SimpleSource><SourceFilename relativeToVRT="{int(relative)}">{name}</SourceFilename>'
        '<SourceBand>1</SourceBand><SrcRect xOff="0" yOff="0" xSize="9" ySize="7"/>'
        f'<DstRect xOff="{column}" yOff="0" xSize="9" ySize="7"/></SimpleSource>'
    )


def vrt(path: Path, bands: str, shape: tuple[int, int] = (7, 9)) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(dataset(bands, shape))
    return path


@pytest.fixture
def nested(tmp_path):
    """A VRT of two VRTs side by side, in another folder than their sources."""
    for index, name in enumerate("ab"):
        write_raster(tmp_path / "tiles" / f"{name}.tif", numbers() + index)
        vrt(tmp_path / "inner" / f"{name}.vrt", band(simple(f"../tiles/{name}.tif")))
    return vrt(tmp_path / "outer.vrt", band(simple("inner/a.vrt"), simple("inner/b.vrt", 9)), (7, 18))


@pytest.fixture(autouse=True)
def _folders(tmp_path):
    (tmp_path / "tiles").mkdir()


def test_files_behind_nested_vrts_with_what_they_fill(nested, tmp_path):
    behind = files_behind(str(nested), nested.read_text())
    west, east = Window(-1, -1, 8, 10), Window(-1, 8, 8, 19)
    assert behind == [
        Behind(str(tmp_path / "inner/a.vrt"), west),
        Behind(str(tmp_path / "tiles/a.tif"), west),
        Behind(str(tmp_path / "inner/b.vrt"), east),
        Behind(str(tmp_path / "tiles/b.tif"), east),
    ]


def test_a_source_that_changes_is_noticed_where_it_is_read(nested, tmp_path):
    source = open_raster([nested]).members[0].source
    write_raster(tmp_path / "tiles" / "b.tif", -numbers())
    source.check(Window(0, 0, 7, 5))
    for window in (Window(0, 5, 7, 15), None):
        with pytest.raises(ChangedInputError, match=r"outer\.vrt: its .*b\.tif: has changed"):
            source.check(window)


@pytest.mark.parametrize("gone", ["tiles/b.tif", "inner/b.vrt"])
def test_a_missing_source_is_named_before_any_work(nested, tmp_path, gone):
    (tmp_path / gone).unlink()
    with pytest.raises(InputError, match=rf"outer\.vrt: .*its source {tmp_path / gone} is missing"):
        open_raster([nested])


def test_a_missing_source_of_a_warped_vrt_is_named(tmp_path):
    path = tmp_path / "warped.vrt"
    path.write_text(
        '<VRTDataset subClass="VRTWarpedDataset" rasterXSize="9" rasterYSize="7"><VRTRasterBand dataType="Float32" '
        'band="1" subClass="VRTWarpedRasterBand"/><GDALWarpOptions><SourceDataset relativeToVRT="1">a.tif'
        "</SourceDataset></GDALWarpOptions></VRTDataset>"
    )
    with pytest.raises(InputError, match=rf"its source {tmp_path / 'a.tif'} is missing"):
        open_raster([path])


def test_sources_in_archives(tmp_path):
    write_raster(tmp_path / "a.tif", numbers())
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.write(tmp_path / "a.tif", "folder/a.tif")
    member = f"/vsizip/{tmp_path / 'a.zip'}/folder/a.tif"
    path = vrt(tmp_path / "a.vrt", band(simple(member, relative=False)))
    raster = open_raster([path])
    assert same(whole(raster), numbers())
    (tmp_path / "a.zip").unlink()
    with pytest.raises(ChangedInputError, match="is gone"):
        raster.members[0].source.check()
    with pytest.raises(InputError, match=f"its source {member} is missing"):
        open_raster([path])


def test_a_vrt_in_an_archive(tmp_path):
    write_raster(tmp_path / "a.tif", numbers())
    vrt(tmp_path / "a.vrt", band(simple("a.tif")))
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        archive.write(tmp_path / "a.tif", "a.tif"), archive.write(tmp_path / "a.vrt", "a.vrt")
    assert same(whole(open_raster([f"/vsizip/{tmp_path / 'a.zip'}/a.vrt"])), numbers())


def test_a_vrt_that_names_itself(tmp_path):
    vrt(tmp_path / "b.vrt", band(simple("a.vrt")))
    with pytest.raises(InputError, match="names itself"):
        open_raster([vrt(tmp_path / "a.vrt", band(simple("b.vrt")))])


def test_raw_bands_are_told_and_so_is_the_network(tmp_path):
    (tmp_path / "secret").write_bytes(bytes(range(63)))
    raster = open_raster([vrt(tmp_path / "raw.vrt", RAW.format("secret"))])
    assert raster.members[0].source.elsewhere == (f"{tmp_path / 'secret'} (raw pixels)",)
    behind = files_behind("a.vrt", dataset(band(simple("http://127.0.0.1:1/a.tif", relative=False))))
    assert [each.name for each in behind] == ["/vsicurl/http://127.0.0.1:1/a.tif"]


@pytest.mark.parametrize("language", ["Python", "PYTHON"])
@pytest.mark.parametrize("level", ["itself", "nested", "inline"])
def test_python_in_a_vrt_never_runs(tmp_path, monkeypatch, language, level):
    monkeypatch.setenv("GDAL_VRT_ENABLE_PYTHON", "YES")
    ran = tmp_path / "ran"
    code = PYTHON.format(language, str(ran))
    path = vrt(tmp_path / "code.vrt", code)
    if level == "nested":
        path = vrt(tmp_path / "outer.vrt", band(simple("code.vrt")))
    elif level == "inline":
        path = vrt(tmp_path / "outer.vrt", band(simple(html.escape(dataset(code)), relative=False)))
    with pytest.raises(InputError, match="computes pixels by Python code, which is not run"):
        open_raster([path])
    assert not ran.exists()


def test_python_stays_off_where_nobody_looks(tmp_path, monkeypatch):
    """The options alone suffice, should code be hidden where it is not looked for."""
    from tilepipe.io.rasters.sources import source

    monkeypatch.setenv("GDAL_VRT_ENABLE_PYTHON", "YES")
    monkeypatch.setattr(source, "files_behind", lambda *_: [])
    ran = tmp_path / "ran"
    with pytest.raises(InputError):
        whole(open_raster([vrt(tmp_path / "code.vrt", PYTHON.format("Python", str(ran)))]))
    assert not ran.exists()


def test_a_broken_vrt_is_named(tmp_path):
    (tmp_path / "a.vrt").write_text("<VRTDataset><VRTRasterBand>")
    with pytest.raises(InputError, match=r"a\.vrt: is no valid VRT"):
        open_raster([tmp_path / "a.vrt"])


def test_values_are_those_of_the_sources(nested):
    assert same(whole(open_raster([nested])), np.hstack([numbers(), numbers() + 1]))
