"""Which bands become grey, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rioxarray  # noqa: F401
import xarray as xr

from tests.scenes import write_raster
from tilepipe.errors import InputError
from tilepipe.pipelines.edges.pass_bands import open_photograph
from tilepipe.tiling.grid import Window


def image(count: int) -> xr.DataArray:
    values = np.random.default_rng(count).integers(1, 256, (count, 20, 30), dtype=np.uint8)
    coords = {"band": np.arange(count) + 1, "y": 20 - np.arange(20) - 0.5, "x": np.arange(30) + 0.5}
    return xr.DataArray(values, dims=("band", "y", "x"), coords=coords, name="photo").rio.write_crs("EPSG:32633")


@pytest.mark.parametrize("grey", ["luminance", "principal"])
def test_a_conversion_of_one_band_is_refused(tmp_path: Path, grey: str) -> None:
    one = write_raster(tmp_path / "one.tif", image(1).values[0])
    for inputs in ([one], [image(1)], [image(1)[0]]):
        with pytest.raises(InputError, match=f"it has one band, which is grey as it is; leave out --set grey={grey}"):
            open_photograph(inputs, crs=None, band=None, grey=grey)
        assert open_photograph(inputs, crs=None, band=None, grey="automatic").conversion == "single band"
    with pytest.raises(InputError, match="--band 2 chooses one band"):
        open_photograph([image(3)], crs=None, band=2, grey=grey)


@pytest.mark.parametrize("grey", ["automatic", "luminance"])
def test_of_many_bands_of_a_store_one_must_be_chosen(tmp_path: Path, grey: str) -> None:
    image(3).to_dataset(name="photo").to_zarr(tmp_path / "photo.zarr", consolidated=False)
    with pytest.raises(InputError, match="has 3 bands; choose one with --band"):
        open_photograph([tmp_path / "photo.zarr"], crs=None, band=None, grey=grey)
    chosen = open_photograph([tmp_path / "photo.zarr"], crs=None, band=2, grey="automatic")
    assert np.array_equal(chosen.read(Window(0, 0, 20, 30)), image(3).values[1])
