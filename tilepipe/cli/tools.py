"""The commands beside the runs: gridding, scores, pictures, and synthetic cities."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from tilepipe.cli.options import Crs, Memory, Quiet, Seed, Workers
from tilepipe.errors import InputError
from tilepipe.io.files.paths import local_output

if TYPE_CHECKING:
    from tilepipe.io.vectors.tables import VectorLayer

_Kind = Literal["lines", "polygons", "edges"]

_APPLIES_TO: dict[str, tuple[_Kind, ...]] = {
    "buffer": ("lines", "polygons"),
    "tolerance": ("edges",),
    "direction": ("lines", "edges"),
    "overlap": ("polygons",),
    "minimum_area": ("polygons",),
    "step": ("polygons",),
    "dissolve": ("polygons", "edges"),
    "road_surface": ("edges",),
}
"""Kinds of scores that the options of `evaluate` are for."""

_BUFFER = 3.0
"""Farthest match of centerlines, or of the boundaries of polygons, in metres."""


def grid(
    clouds: Annotated[list[str], typer.Argument(help="LAS, LAZ or COPC files, or folders of them.")],
    out: Annotated[Path, typer.Option(help="GeoTIFF to write.")],
    resolution: Annotated[float, typer.Option(help="Cell size in metres.")] = 0.5,
    value: Annotated[Literal["height", "intensity"], typer.Option(help="What to grid.")] = "height",
    method: Annotated[
        Literal["nearest", "max", "min", "mean", "idw"], typer.Option(help="How a cell gets its value.")
    ] = "nearest",
    void_reach: Annotated[float, typer.Option(help="Fill voids from values within this reach (m).")] = 1.5,
    returns: Annotated[Literal["all", "first", "last"], typer.Option(help="Returns to use.")] = "all",
    idw_radius: Annotated[float | None, typer.Option(help="Radius of idw (m); the cell's diagonal by default.")] = None,
    classes: Annotated[str | None, typer.Option(help="Point classes to use, such as 2,6.")] = None,
    crs: Crs = None,
    memory: Memory = "2GiB",
    workers: Workers = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an existing file.")] = False,
    quiet: Quiet = False,
) -> None:
    """Grid lidar point clouds to a raster of heights or intensities."""
    from tilepipe.cli.bars import progress_bars
    from tilepipe.engine.options import default_workers, parse_memory
    from tilepipe.pipelines.points.recipe import grid_clouds

    with progress_bars(quiet) as progress:
        path = grid_clouds(
            clouds,
            out,
            resolution=resolution,
            value=value,
            method=method,
            void_reach=void_reach,
            idw_radius=idw_radius,
            returns=returns,
            classes=_numbers(classes),
            crs=crs,
            memory=parse_memory(memory),
            workers=workers or default_workers(),
            overwrite=overwrite,
            progress=progress,
        )
    if not quiet:
        print(path)


def _numbers(text: str | None) -> list[int] | None:
    try:
        return None if text is None else [int(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"--classes {text}: write class numbers with commas, such as 2,6") from None


def evaluate(
    result: Annotated[Path, typer.Argument(help="Table of lines or polygons, or the folder of a run.")],
    truth: Annotated[Path, typer.Argument(help="Table of true lines or polygons.")],
    buffer: Annotated[
        float | None, typer.Option(help="Farthest match of lines, or of polygons' boundaries (m); 3 by default.")
    ] = None,
    tolerance: Annotated[
        float | None, typer.Option(help="Edges: farthest match (m); 1 by default. Any other lines are then edges too.")
    ] = None,
    area: Annotated[
        Path | None,
        typer.Option(help="Polygon table: score only inside; by default where the result's run has had data."),
    ] = None,
    direction: Annotated[float | None, typer.Option(help="Largest angle between matching lines (degrees).")] = None,
    overlap: Annotated[
        float | None, typer.Option(help="Polygons: share of an object's area that must match; 0.5 by default.")
    ] = None,
    minimum_area: Annotated[
        float | None, typer.Option(help="Polygons: score objects from this area also apart (m²); 50 by default.")
    ] = None,
    step: Annotated[
        float | None, typer.Option(help="Polygons: sampling of the boundaries (m); 0.5 by default.")
    ] = None,
    dissolve: Annotated[
        bool,
        typer.Option(
            "--dissolve",
            help="Polygons: in both layers, those that touch are one object. Not for a layer that divides all of the "
            "ground, such as objects.parquet: score buildings.parquet. Edges: true polygons that touch are one.",
        ),
    ] = False,
    road_surface: Annotated[
        bool,
        typer.Option(
            "--road-surface", help="Edges: the truth is polygons of road; also score the borders and widths of streets."
        ),
    ] = False,
    layer: Annotated[str | None, typer.Option(help="Layer of the truth, in a file of several.")] = None,
    result_layer: Annotated[str | None, typer.Option(help="Layer of the result, in a file of several.")] = None,
    area_layer: Annotated[str | None, typer.Option(help="Layer of the area, in a file of several.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Machine-readable output.")] = False,
) -> None:
    """Score lines (Heipke et al. 1997), polygons (Rutzinger et al. 2009), or edges, against lines or polygons.

    Scores of edges come with what the same edges score by chance: against the truth moved aside by 8 to 14 times the
    tolerance.
    """
    from tilepipe.evaluate.edges import TOLERANCE, EdgeScore, evaluate_edges
    from tilepipe.evaluate.extent import scored_area
    from tilepipe.evaluate.lines import LineScore, evaluate
    from tilepipe.evaluate.polygons import AreaScore, evaluate_areas
    from tilepipe.evaluate.results import read_result
    from tilepipe.io.vectors.tables import are_polygons, read_layer

    extracted, true = layers = read_result(result, result_layer), read_layer(truth, "truth", layer)
    if area is None and area_layer is not None:
        raise InputError("--area-layer names a layer of --area; give that too, or leave it out")
    inside = scored_area(result, area, area_layer)
    kind = _kind(*layers, as_edges=tolerance is not None)
    of_polygons = {"overlap": overlap, "minimum_area": minimum_area, "step": step}
    numbers = {"buffer": buffer, "tolerance": tolerance, "direction": direction, **of_polygons}
    switches = {"dissolve": dissolve, "road_surface": road_surface}
    given = [name for name, value in numbers.items() if value is not None]
    _refuse_others(kind, given + [name for name, wanted in switches.items() if wanted])
    score: LineScore | AreaScore | EdgeScore
    if kind == "edges":
        score = evaluate_edges(
            *layers,
            TOLERANCE if tolerance is None else tolerance,
            inside,
            direction_tolerance=direction,
            dissolve=dissolve,
            road_surface=road_surface,
        )
    elif are_polygons(*layers):
        chosen = {name: value for name, value in of_polygons.items() if value is not None}
        cutoff = _BUFFER if buffer is None else buffer
        score = evaluate_areas(extracted, true, inside, cutoff=cutoff, dissolve=dissolve, **chosen)
    else:
        score = evaluate(*layers, _BUFFER if buffer is None else buffer, inside, direction_tolerance=direction)
    print(json.dumps(score.as_dict()) if as_json else score.summary())


def _kind(result: VectorLayer, truth: VectorLayer, *, as_edges: bool) -> _Kind:
    """What a result is scored as; an empty one as what the truth holds."""
    from tilepipe.evaluate.edges import is_edges
    from tilepipe.io.vectors.tables import POLYGONS

    if is_edges(result):
        return "edges"
    if (result.types or truth.types) & set(POLYGONS):
        return "polygons"
    return "edges" if as_edges else "lines"


def _refuse_others(kind: _Kind, given: list[str]) -> None:
    """Refuse options that do not apply to a kind of score.

    Raises
    ------
    InputError
        Names all of them.
    """
    others = [name for name in given if kind not in _APPLIES_TO[name]]
    if not others:
        return
    told = [f"--{name.replace('_', '-')} is for {' and '.join(_APPLIES_TO[name])}" for name in others]
    match = ", which match within --tolerance" if kind == "edges" and "buffer" in others else ""
    raise InputError(f"{', '.join(told)}; leave {'it' if len(others) == 1 else 'them'} out for {kind}{match}")


def report(folder: Annotated[Path, typer.Argument(help="Folder of a finished run.")]) -> None:
    """Draw quick-look pictures and a map page of a run."""
    from tilepipe.engine.pipeline import DEFAULT_PICTURES
    from tilepipe.pipelines import registry

    if not local_output(folder).is_dir():
        raise InputError(f"{folder}: no such folder; give the folder of a finished run")
    able = registry.pipelines_of(folder)
    made = next((item for item in able if any((folder / name).is_file() for name in item.layers[0].files)), None)
    if made is None:
        wanted = ", ".join(item.layers[0].name for item in able)
        raise InputError(f"{folder} holds none of {wanted}; give the folder of a finished run")
    draw = registry.part(made.pictures)
    if made.pictures == DEFAULT_PICTURES:
        draw = partial(draw, layers=[layer.name for layer in made.layers])
    for path in draw(folder):
        print(path)


def demo(
    out: Annotated[Path, typer.Option(help="Folder of the demo.")] = Path("demo"),
    size: Annotated[int, typer.Option(help="Side of the synthetic city in pixels.")] = 2048,
    seed: Seed = 0,
    quiet: Quiet = False,
) -> None:
    """Make a synthetic city, find its streets, score them, and draw them."""
    from tilepipe.cli.bars import progress_bars
    from tilepipe.cli.demo import run_demo

    with progress_bars(quiet) as progress:
        result = run_demo(out, size=size, seed=seed, progress=progress)
    print(result)


def city(
    out: Annotated[Path, typer.Argument(help="Folder to write.")],
    size: Annotated[int, typer.Option(help="Side in pixels.")] = 2048,
    resolution: Annotated[float, typer.Option(help="Pixel size in metres.")] = 0.5,
    layers: Annotated[str, typer.Option(help="Layers with commas: intensity,height,aerial,…")] = "intensity,height",
    seed: Seed = 0,
    workers: Workers = None,
    quiet: Quiet = False,
) -> None:
    """Write a seeded synthetic city of any size with its truth."""
    from tilepipe.cli.bars import progress_bars
    from tilepipe.engine.options import default_workers
    from tilepipe.synthetic import City, write_city

    with progress_bars(quiet) as progress:
        paths = write_city(
            out,
            City(seed=seed, rows=size, columns=size, resolution=resolution),
            layers=tuple(layers.split(",")),
            workers=workers or default_workers(),
            progress=partial(progress, "city"),
        )
    if not quiet:
        for path in paths.values():
            print(path)
