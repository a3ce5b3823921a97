"""Operators on xarray arrays: the same values for any chunks, lazy, with everything that the array carried."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import dask
import dask.array as da
import numpy as np
import pytest
import rioxarray
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

import tilepipe.accessor  # noqa: F401
from tests.scenes import band, draw, ring, write_raster
from tilepipe.errors import InputError
from tilepipe.io.rasters.raster import as_dataarray, open_raster
from tilepipe.tiling.grid import Window
from tilepipe_kernels.heights import ground
from tilepipe_kernels.image import diffusion, grey_levels, morphology
from tilepipe_kernels.mrf.edge_model import EdgeModel
from tilepipe_kernels.mrf.labels.intensity_field import intensity_field
from tilepipe_kernels.mrf.lines.minimise import line_field
from tilepipe_kernels.mrf.search import Search
from tilepipe_kernels.network import skeleton
from tilepipe_kernels.nevatia_babu.elements import thin_edges
from tilepipe_kernels.nevatia_babu.masks import edge_responses
from tilepipe_kernels.regions import growing, quadtree
from tilepipe_kernels.regions.quadtree_sums import MISSING
from tilepipe_kernels.ridges.links import link_points
from tilepipe_kernels.ridges.points import line_points

SHAPE = (60, 71)
STREETS = band(SHAPE, (-5, 20), (70, 50), 7) | ring(SHAPE, (30, 45), 18, 5)


def greys(seed: int = 0) -> np.ndarray:
    values = draw(SHAPE, STREETS, seed)
    values[20:22, 30:34] = np.nan
    return values


def array(values: np.ndarray) -> xr.DataArray:
    """A raster with a name, attributes, coordinates of its own and a CRS."""
    rows, columns = values.shape
    coords = {"y": 5e6 - np.arange(rows) - 0.5, "x": 5e5 + np.arange(columns) + 0.5, "acquired": 2012}
    attrs = {"units": "grey", "source": "lidar"}
    made = xr.DataArray(values, dims=("y", "x"), coords=coords, name="scene", attrs=attrs)
    return made.rio.write_crs("EPSG:32633")


OPERATORS: dict[str, tuple[bool | None, Callable[[Any], xr.DataArray], Callable[[np.ndarray], np.ndarray]]] = {
    "diffuse": (
        False,
        lambda a: a.tilepipe.diffuse(steps=4, gradient_sigma=1.5),
        lambda v: diffusion.diffuse(
            v, steps=4, time_step=0.5, conductance=0.01, gradient_sigma=1.5, fidelity=0.5, model="curvature"
        ),
    ),
    "ridge_lines": (False, lambda a: a.tilepipe.ridge_lines(sigma=2.0, low=0.5), None),
    "medial_axis": (
        True,
        lambda a: a.tilepipe.medial_axis(half_width=6),
        lambda m: skeleton.medial_axis(m, cap=6, separation=5.0),
    ),
    "open_mask": (True, lambda a: a.tilepipe.open_mask(radius=2.5), lambda m: morphology.open_mask(m, 2.5)),
    "close_mask": (True, lambda a: a.tilepipe.close_mask(radius=3), lambda m: morphology.close_mask(m, 3)),
    "grow_regions": (
        False,
        lambda a: a.tilepipe.grow_regions(tolerance=9, minimum_size=5, maximum=100),
        None,
    ),
}
MEANS = (40.0, 90.0, 140.0, 170.0)
CALM = EdgeModel(levels=4, gamma=0.2, xi=0.2)


def levels_of(values: np.ndarray) -> np.ndarray:
    return grey_levels.to_levels(values.astype(np.float32), np.array(MEANS))


def lines_of(labels: np.ndarray) -> np.ndarray:
    found = line_field(labels, CALM, search=Search(rounds=6))
    return np.where(labels == 255, 255, found.horizontal | found.vertical << 1)


def leaf_means(values: np.ndarray) -> np.ndarray:
    ticks = np.where(np.isnan(values), MISSING, np.rint(np.nan_to_num(values).astype(float) * 1000)).astype(np.int32)
    labels, leaves = quadtree.split(ticks, threshold=12_000.0**2, smallest=1, largest=8)
    return np.append(np.nan, leaves.total / leaves.count / 1000)[labels].astype(np.float32)


def steps_of(values: np.ndarray) -> np.ndarray:
    magnitude, direction = edge_responses(values)
    elements = thin_edges(magnitude, direction, 20_000)
    return np.where(elements < 255, magnitude / 1000, 0).astype(np.float32)


# line elements are between levels: neither greys nor a mask
OPERATORS |= {
    "quadtree": (False, lambda a: a.tilepipe.quadtree(deviation=12, largest=8), leaf_means),
    "ground": (
        False,
        lambda a: a.tilepipe.ground(resolution=1.0, largest_object=12),
        lambda v: ground.ground_height(v, resolution=1.0, largest_object=12),
    ),
    "segment": (
        False,
        lambda a: a.tilepipe.segment(means=MEANS, rounds=6),
        lambda v: intensity_field(levels_of(v), EdgeModel(levels=4), search=Search(rounds=6)).labels,
    ),
    "line_field": (
        None,
        lambda a: a.tilepipe.line_field(levels=4, rounds=6, gamma=0.2, xi=0.2),
        lines_of,
    ),
    "nevatia_babu": (False, lambda a: a.tilepipe.nevatia_babu(threshold=20), steps_of),
}
LOCAL = [name for name in OPERATORS if name != "grow_regions"]
CHUNKS = [(17, 23), (60, 9), (4, 71), ((1, 38, 2, 19), (40, 3, 28)), (60, 71)]


def raster_for(name: str) -> np.ndarray:
    if name == "line_field":
        return intensity_field(levels_of(greys()), CALM).labels
    noise = np.random.default_rng(1).random(SHAPE) < 0.03
    return STREETS ^ noise if OPERATORS[name][0] else greys()


@pytest.mark.parametrize("chunks", CHUNKS)
@pytest.mark.parametrize("name", LOCAL)
def test_chunks_are_invisible(name, chunks):
    values = raster_for(name)
    operator = OPERATORS[name][1]
    reference = operator(array(values))
    lazy = operator(array(values).chunk(dict(zip(("y", "x"), chunks, strict=True))))
    assert isinstance(lazy.data, da.Array)
    assert lazy.data.chunks == array(values).chunk(dict(zip(("y", "x"), chunks, strict=True))).data.chunks
    assert lazy.dtype == reference.dtype
    computed = lazy.compute(scheduler="synchronous")
    assert computed.dtype == reference.dtype
    assert np.array_equal(computed.values, reference.values, equal_nan=reference.dtype.kind == "f")
    assert np.count_nonzero(np.nan_to_num(reference.values)) > 0


@pytest.mark.parametrize("name", [name for name in OPERATORS if OPERATORS[name][2] is not None])
def test_operators_are_the_kernels(name):
    values = raster_for(name)
    assert np.array_equal(OPERATORS[name][1](array(values)).values, OPERATORS[name][2](values), equal_nan=True)


def test_ridge_lines_are_the_linked_points():
    points = line_points(greys(), 2.0, low=0.5, dark=True)
    linked = points.take(np.flatnonzero(link_points(points)))
    found = array(greys()).tilepipe.ridge_lines(sigma=2.0, low=0.5).values
    assert set(zip(*np.nonzero(found), strict=True)) == set(zip(linked.row, linked.col, strict=True))


@pytest.mark.parametrize("name", OPERATORS)
@pytest.mark.parametrize("chunked", [False, True])
def test_what_the_array_carried_is_kept(name, chunked):
    source = array(raster_for(name))
    source = source.chunk(y=20, x=20) if chunked else source
    result = OPERATORS[name][1](source)
    assert result.attrs == source.attrs
    assert result.name == name
    assert result.dims == ("y", "x")
    assert result.chunks == source.chunks
    assert set(result.coords) == set(source.coords)
    assert all(result[c].identical(source[c]) for c in ("y", "x", "acquired"))
    assert result.rio.crs == source.rio.crs
    assert source.identical(array(raster_for(name)))


@pytest.mark.parametrize("name", OPERATORS)
def test_nothing_is_computed_before_it_is_due(name):
    reads = []

    def read(block: np.ndarray, block_info: Any = None) -> np.ndarray:
        reads.append(block_info[0]["chunk-location"])
        return block

    values = raster_for(name)
    data = da.map_blocks(read, da.from_array(values, chunks=(20, 24)), dtype=values.dtype, meta=values[:0, :0])
    lazy = OPERATORS[name][1](array(values).copy(data=data))
    assert reads == []
    lazy.compute(scheduler="synchronous")
    assert set(reads) == {(i, j) for i in range(3) for j in range(3)}
    assert len(reads) == 9


def test_a_part_reads_its_surroundings_only():
    reads = []

    def read(block: np.ndarray, block_info: Any = None) -> np.ndarray:
        reads.append(block_info[0]["chunk-location"])
        return block

    data = da.map_blocks(read, da.from_array(STREETS, chunks=(20, 24)), dtype=bool, meta=STREETS[:0, :0])
    opened = array(STREETS).copy(data=data).tilepipe.open_mask(radius=2)
    opened[:20, :24].compute(scheduler="synchronous")
    assert set(reads) == {(0, 0), (0, 1), (1, 0), (1, 1)}


def test_threads_give_the_same():
    lazy = array(greys()).chunk(y=13, x=19)
    with dask.config.set(scheduler="threads", num_workers=2):
        found = [OPERATORS[name][1](lazy.chunk(y=20, x=20)).values for name in ("diffuse", "grow_regions")]
    expected = [OPERATORS[name][1](array(greys())).values for name in ("diffuse", "grow_regions")]
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(found, expected, strict=True))


# --- regions across chunks


def naive_regions(values: np.ndarray, tolerance: float, minimum_size: int) -> np.ndarray:
    """Breadth-first search from every pixel in row-major order."""
    ids, found = np.zeros(values.shape, np.uint32), 0
    seen = np.isnan(values)
    for start in np.ndindex(values.shape):
        if seen[start]:
            continue
        seen[start], members = True, [start]
        for row, column in members:
            for r, c in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
                inside = 0 <= r < values.shape[0] and 0 <= c < values.shape[1]
                if inside and not seen[r, c] and abs(values[r, c] - values[row, column]) <= np.float32(tolerance):
                    seen[r, c] = True
                    members.append((r, c))
        if len(members) >= minimum_size:
            found += 1
            ids[tuple(np.transpose(members))] = found
    return ids


@pytest.mark.parametrize("chunks", [(7, 7), (13, 40), (40, 1), (40, 40), (3, 11)])
def test_rings_keep_one_id_across_chunks(chunks):
    shape = (40, 40)
    rings = ring(shape, (19, 20), 15, 2.5) | ring(shape, (19, 20), 8, 2.5) | ring(shape, (19, 20), 1, 2)
    source = array(np.where(rings, 40, 160).astype(np.float32))
    expected = naive_regions(source.values, 5, 1)
    assert expected.max() == 6
    found = source.chunk(y=chunks[0], x=chunks[1]).tilepipe.grow_regions(tolerance=5)
    assert np.array_equal(found.values, expected)
    assert found.dtype == np.uint32
    only = source.chunk(y=chunks[0], x=chunks[1]).tilepipe.grow_regions(tolerance=5, maximum=100)
    assert np.array_equal(only.values, ndimage.label(rings)[0])


@settings(max_examples=15)
@given(
    seed=st.integers(0, 2**20),
    rows=st.integers(4, 25),
    columns=st.integers(4, 25),
    minimum_size=st.sampled_from([1, 4, 30]),
)
def test_regions_of_any_texture_in_any_chunks(seed, rows, columns, minimum_size):
    rng = np.random.default_rng(seed)
    values = np.round(ndimage.gaussian_filter(rng.normal(size=(24, 22)), 1) * 30).astype(np.float32)
    values[rng.random(values.shape) < 0.05] = np.nan
    expected = naive_regions(values, 4, minimum_size)
    source = array(values)
    for raster in (source, source.chunk(y=rows, x=columns)):
        found = raster.tilepipe.grow_regions(tolerance=4, minimum_size=minimum_size)
        assert np.array_equal(found.values, expected)


def test_uneven_chunks_are_refused_for_regions():
    with pytest.raises(InputError, match=r"uneven: rechunk to equal chunks"):
        array(greys()).chunk(y=(10, 30, 20), x=71).tilepipe.grow_regions(tolerance=3)
    whole = array(greys()).tilepipe.grow_regions(tolerance=3)
    even = array(greys()).chunk(y=25, x=30).tilepipe.grow_regions(tolerance=3)
    assert np.array_equal(even.values, whole.values)


def test_the_kernel_grows_the_same_parts():
    values = greys()
    ours = array(values).tilepipe.grow_regions(tolerance=9, maximum=100).values
    theirs = growing.grow_regions(values, 9, maximum=100)
    pairs = set(zip(ours.ravel().tolist(), theirs.ravel().tolist(), strict=True))
    assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})


# --- nodata and dtypes


@pytest.mark.parametrize("name", ["diffuse", "ridge_lines", "grow_regions"])
@pytest.mark.parametrize("chunked", [False, True])
def test_the_nodata_value_of_an_array_is_no_grey(name, chunked):
    whole = np.rint(np.nan_to_num(greys(), nan=-1)).astype(np.int16)
    packed = array(whole).rio.write_nodata(-1)
    packed = packed.chunk(y=20, x=30) if chunked else packed
    expected = OPERATORS[name][1](array(np.where(whole == -1, np.nan, whole).astype(np.float32)))
    found = OPERATORS[name][1](packed)
    assert np.array_equal(found.values, expected.values, equal_nan=True)
    if found.dtype.kind == "f":
        assert np.isnan(found.rio.nodata)
    else:
        assert found.rio.nodata is None


def test_results_of_an_opened_raster_can_be_written(tmp_path):
    import rasterio

    raster = as_dataarray(open_raster([write_raster(tmp_path / "a.tif", greys())]), chunks=25)
    for name in OPERATORS:
        source = raster < 100 if OPERATORS[name][0] is not False else raster
        result = OPERATORS[name][1](source)
        if result.dtype == bool:
            result = result.astype(np.uint8)
        result.rio.to_raster(tmp_path / f"{name}.tif")
        with rasterio.open(tmp_path / f"{name}.tif") as dataset:
            assert np.array_equal(dataset.read(1), result.values, equal_nan=True)
            assert dataset.crs.to_epsg() == 32633


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.int32, np.float64])
def test_any_real_dtype(dtype):
    whole = np.rint(np.nan_to_num(greys(), nan=9)).clip(0, 255)
    for name in ("diffuse", "grow_regions", "ridge_lines"):
        expected = OPERATORS[name][1](array(whole.astype(np.float32))).values
        found = OPERATORS[name][1](array(whole.astype(dtype)).chunk(y=31, x=31)).values
        assert np.array_equal(found, expected), name
    opened = OPERATORS["open_mask"][1]
    nan_is_background = np.where(STREETS, 1, np.nan)
    for mask in (STREETS.astype(np.uint8), nan_is_background, STREETS * np.int32(7)):
        assert np.array_equal(opened(array(mask)).values, opened(array(STREETS)).values)


@pytest.mark.parametrize("place", ["attrs", "encoding"])
def test_integers_whose_nodata_value_is_nan_have_none(place):
    whole = np.rint(np.nan_to_num(greys())).astype(np.uint8)
    raster = array(whole)
    getattr(raster, place)["_FillValue"] = np.nan
    for name in ("diffuse", "grow_regions"):
        found = OPERATORS[name][1](raster)
        assert np.array_equal(found.values, OPERATORS[name][1](array(whole)).values)
        assert ("_FillValue" in found.attrs) == (found.dtype.kind == "f")


def test_tasks_bear_the_name_of_the_operator():
    lazy = array(greys()).chunk(y=20, x=20).tilepipe.diffuse(steps=1)
    assert any(str(key).startswith("diffuse-") for key in lazy.__dask_graph__())


@pytest.mark.parametrize("means", [[5], [], 5, [5, 5], [7, 5], [5, np.nan], range(300)])
def test_means_are_checked_at_once(means):
    with pytest.raises(InputError, match=r"^means must"):
        array(greys()).chunk(y=20, x=20).tilepipe.segment(means=means)


@pytest.mark.parametrize("deviation", [-1, np.nan])
def test_a_negative_deviation_is_refused(deviation):
    with pytest.raises(InputError, match="deviation must be 0 or more"):
        array(greys()).tilepipe.quadtree(deviation=deviation)


@pytest.mark.parametrize("weights", [{"sigma": 0.0}, {"sharpness": 1}, {"levels": 3}, {"beta": "much"}])
def test_weights_of_the_edges_are_checked_at_once(weights):
    with pytest.raises(InputError, match=f"model of the edges.*{next(iter(weights))}"):
        array(greys()).chunk(y=20, x=20).tilepipe.segment(means=MEANS, **weights)


@pytest.mark.parametrize(
    ("operator", "given", "told"),
    [
        ("segment", {"method": "serial"}, "method must be one of parallel, messages, icm, annealing, not 'serial'"),
        ("line_field", {"method": "messages"}, "method must be one of parallel, icm, annealing, not 'messages'"),
        ("segment", {"rounds": 0}, "rounds must be a whole number from 1"),
        ("line_field", {"rounds": 2.5}, "rounds must be a whole number from 1"),
    ],
)
def test_optimisers_of_the_edges_are_checked_at_once(operator, given, told):
    lazy = array(greys()).chunk(y=20, x=20).tilepipe
    with pytest.raises(InputError, match=f"^{operator}: {told}"):
        getattr(lazy, operator)(**({"means": MEANS} if operator == "segment" else {"levels": 4}), **given)


@pytest.mark.parametrize("wrong", [3, 7, -1, 1.5])
@pytest.mark.parametrize("chunked", [False, True])
def test_line_field_says_which_levels_it_takes(wrong, chunked):
    values = np.where(greys() > 100, 1.0, 2.0)
    values[5, 5], values[6, 6], values[7, 7] = 255, np.nan, wrong
    levels = array(values)
    levels = levels.chunk(y=20, x=20) if chunked else levels
    with pytest.raises(InputError, match=rf"^line_field: levels=3 is for an array of 0 to 2 .* holds {wrong:g};"):
        levels.tilepipe.line_field(levels=3, rounds=2).compute(scheduler="synchronous")
    levels[7, 7] = 0
    found = levels.tilepipe.line_field(levels=3, rounds=2).values
    assert found[5, 5] == found[6, 6] == 255 and found[7, 7] < 255


@pytest.mark.parametrize("dims", [("band", "y", "x"), ("x",)])
def test_other_numbers_of_dimensions_are_refused(dims):
    wrong = xr.DataArray(np.zeros((3,) * len(dims)), dims=dims)
    with pytest.raises(InputError, match=f"two dimensions, not {len(dims)}: select a band"):
        wrong.tilepipe.diffuse()


# --- how an array is stored


def packed(dtype: str = "int16") -> tuple[xr.DataArray, xr.DataArray]:
    """Heights stored in centimetres above 100 m with a void, and the same as they are meant."""
    stored = np.rint(greys() * 100).astype(np.float32)
    meant = np.where(np.isnan(stored), np.nan, stored.astype(np.float64) * 0.01 + 100).astype(np.float32)
    stored = np.where(np.isnan(stored), -32768, stored).astype(dtype)
    attributes = {"scale_factor": 0.01, "add_offset": 100.0, "_FillValue": np.dtype(dtype).type(-32768)}
    return array(stored).assign_attrs(attributes), array(meant)


STORED = ("scale_factor", "add_offset", "scales", "offsets")
OF_VALUES = {
    "diffuse": lambda a: a.tilepipe.diffuse(steps=2),
    "ground": lambda a: a.tilepipe.ground(resolution=1.0, largest_object=12),
    "quadtree": lambda a: a.tilepipe.quadtree(deviation=12, largest=8),
    "grow_regions": lambda a: a.tilepipe.grow_regions(tolerance=9, minimum_size=5),
    "ridge_lines": lambda a: a.tilepipe.ridge_lines(sigma=2.0, low=0.5),
    "segment": lambda a: a.tilepipe.segment(means=[140, 260], rounds=3),
    "nevatia_babu": lambda a: a.tilepipe.nevatia_babu(threshold=20),
}


@pytest.mark.parametrize("chunked", [False, True])
@pytest.mark.parametrize("name", OF_VALUES)
def test_a_packed_array_is_what_it_means(name, chunked):
    stored, meant = packed()
    stored = stored.chunk(y=20, x=20) if chunked else stored
    found = OF_VALUES[name](stored)
    assert np.array_equal(found.values, OF_VALUES[name](meant).values, equal_nan=found.dtype.kind == "f")
    assert not set(found.attrs) & set(STORED)
    assert stored.attrs["scale_factor"] == 0.01
    nodata = {"f": np.nan, "u": 255 if name == "segment" else None}[found.dtype.kind]
    assert found.attrs.get("_FillValue") is nodata or found.attrs.get("_FillValue") == nodata


def test_scales_that_rioxarray_keeps_for_each_band(tmp_path):
    import rasterio

    values = packed()[0].values
    with rasterio.open(
        tmp_path / "a.tif",
        "w",
        driver="GTiff",
        height=SHAPE[0],
        width=SHAPE[1],
        count=2,
        dtype="int16",
        nodata=-32768,
        crs="EPSG:32633",
        transform=rasterio.Affine(1, 0, 5e5, 0, -1, 5e6),
    ) as file:
        file.write(np.stack([values, values]))
        file.scales, file.offsets = (1.0, 0.01), (0.0, 100.0)
    with pytest.warns(UserWarning, match="differ across bands"):
        bands = rioxarray.open_rasterio(tmp_path / "a.tif")
    expected = packed()[1].tilepipe.ground(resolution=1.0, largest_object=12)
    found = bands[1].tilepipe.ground(resolution=1.0, largest_object=12)
    assert np.array_equal(found.values, expected.values, equal_nan=True)
    assert not set(found.attrs) & set(STORED)
    assert np.array_equal(open_raster([bands], band=2).read(Window(0, 0, *SHAPE)), packed()[1].values, equal_nan=True)
    with pytest.raises(InputError, match="its bands have different scales; open it with mask_and_scale=True"):
        bands[1].drop_vars("band").tilepipe.ground(resolution=1.0)


def test_what_was_decoded_is_not_scaled_again(tmp_path):
    stored, meant = packed()
    stored.to_dataset(name="a").to_zarr(tmp_path / "a.zarr", zarr_format=2, consolidated=False)
    decoded = xr.open_zarr(tmp_path / "a.zarr", consolidated=False)["a"]
    assert decoded.encoding["scale_factor"] == 0.01
    found = decoded.tilepipe.ground(resolution=1.0, largest_object=12)
    expected = meant.tilepipe.ground(resolution=1.0, largest_object=12)
    assert np.allclose(found.values, expected.values, equal_nan=True)
    found.to_dataset(name="b").to_zarr(tmp_path / "b.zarr", zarr_format=2, consolidated=False)
    assert np.array_equal(xr.open_zarr(tmp_path / "b.zarr", consolidated=False)["b"], found, equal_nan=True)


@pytest.mark.parametrize(("dtype", "nodata"), [("int16", -32768), ("int64", 2**60 + 1), ("float32", -3.40282346639e38)])
def test_nodata_of_attributes_is_nodata(dtype, nodata):
    values = np.nan_to_num(greys()).astype(dtype)
    values[20:22, 30:34] = nodata
    for key in ("_FillValue", "missing_value", "nodata"):
        marked = array(values).assign_attrs({key: nodata})
        found = marked.tilepipe.quadtree(deviation=12, largest=1)
        assert np.isnan(found.values[20:22, 30:34]).all()
        assert np.isnan(found.values).sum() == 8


def test_an_infinity_is_nodata():
    values = greys()
    values[20:22, 30:34] = np.inf
    assert np.array_equal(
        array(values).tilepipe.diffuse(steps=4).values, array(greys()).tilepipe.diffuse(steps=4).values, equal_nan=True
    )


@pytest.mark.parametrize("name", OPERATORS)
def test_rows_are_those_of_the_map(name):
    """What is below a pixel is so on the map too, whatever the order of the dims."""
    source = array(raster_for(name))
    for turned in (source.transpose("x", "y"), source.transpose("x", "y").chunk(y=20, x=20)):
        found = OPERATORS[name][1](turned)
        assert found.dims == ("x", "y")
        assert found.chunks == turned.chunks
        expected = OPERATORS[name][1](source)
        assert np.array_equal(found.transpose("y", "x").values, expected.values, equal_nan=found.dtype.kind == "f")


@pytest.mark.parametrize("name", OPERATORS)
@pytest.mark.parametrize("chunked", [False, True])
def test_an_array_that_runs_against_the_map_gives_the_same(name, chunked):
    """Squares, cells and directions are those of the map, whichever way rows and columns run."""
    source = array(raster_for(name))
    expected = OPERATORS[name][1](source)
    for dim in ("y", "x"):
        turned = source.isel({dim: slice(None, None, -1)})
        if chunked:
            turned = turned.chunk(y=20, x=20)
        found = OPERATORS[name][1](turned)
        assert found.chunks == turned.chunks
        assert found[dim].equals(turned[dim])
        values = found.isel({dim: slice(None, None, -1)}).values
        if name == "grow_regions":  # the same regions, numbered in the order of the array
            pairs = np.unique(np.stack([values, expected.values]).reshape(2, -1), axis=1)
            assert pairs.shape[1] == expected.values.max() + 1 == values.max() + 1
        else:
            assert np.array_equal(values, expected.values, equal_nan=found.dtype.kind == "f")


def test_chunks_of_unknown_sizes_are_refused():
    data = da.from_array(greys(), chunks=20)
    unknown = data[da.from_array(np.ones(SHAPE[0], bool), chunks=20)]
    lazy = xr.DataArray(unknown, dims=("y", "x"))
    for operator in (lambda a: a.tilepipe.diffuse(), lambda a: a.tilepipe.grow_regions(tolerance=1)):
        with pytest.raises(InputError, match=r"chunks of unknown sizes; make it of dask_array\.compute_chunk_sizes"):
            operator(lazy)
    with pytest.raises(InputError, match="chunks of unknown sizes"):
        open_raster([lazy], crs="EPSG:32633")
