"""The pipelines by name: those of tilepipe, and those that other packages declare.

A package adds a pipeline by an entry point of the group ``tilepipe.pipelines`` that names its `Pipeline`::

    [project.entry-points."tilepipe.pipelines"]
    roofs = "roof_package:PIPELINE"

Entry points are read only for names that tilepipe does not know itself, and to list all names, so that start-up does
not wait for other packages.
"""

from __future__ import annotations

from collections import defaultdict
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tilepipe.errors import InputError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from tilepipe.engine.inputs import Input
    from tilepipe.engine.pipeline import Pipeline

GROUP = "tilepipe.pipelines"

OWN = ("streets", "objects", "edges")
"""Pipelines of tilepipe: names of their folders and commands."""


def pipeline(name: str) -> Pipeline:
    """A pipeline by its name.

    Raises
    ------
    InputError
        When no package declares it, several do, or the package that does cannot be used; names the package.

    Examples
    --------
    >>> from tilepipe.pipelines.registry import pipeline
    >>> [layer.name for layer in pipeline("streets").layers]
    ['streets.tif', 'centerlines', 'skeleton']
    """
    if name in OWN:
        found: Pipeline = import_module(f"tilepipe.pipelines.{name}.pipeline").PIPELINE
        return found
    declared = _foreign().get(name, [])
    if not declared:
        raise InputError(f"pipeline '{name}' is unknown; known are {', '.join(names())}")
    if len(declared) > 1:
        packages = " and ".join(_package(point) for point in declared)
        raise InputError(f"pipeline '{name}' is declared twice, by the packages {packages}; uninstall one of them")
    return _load(declared[0])


def face(name: str) -> tuple[str, tuple[Input, ...]]:
    """Summary and further inputs of a pipeline, for its command; tilepipe's own are not imported for it.

    Raises
    ------
    InputError
        As for `pipeline`.
    """
    declared: Any
    if name in OWN:
        declared = import_module(f"tilepipe.pipelines.{name}")
        return declared.SUMMARY, declared.INPUTS
    declared = pipeline(name)
    return declared.summary, declared.inputs


def is_known(name: str) -> bool:
    """Whether some package declares a pipeline of this name; for tilepipe's own no other package is asked."""
    return name in OWN or name in _foreign()


def names() -> list[str]:
    """Names of all pipelines: tilepipe's own, then those of other packages in alphabetical order.

    Examples
    --------
    >>> from tilepipe.pipelines.registry import names
    >>> {"edges", "objects", "streets"} <= set(names())
    True
    """
    return [*OWN, *sorted(set(_foreign()) - set(OWN))]


def pipelines_of(folder: Path) -> list[Pipeline]:
    """Pipeline that has made a run, by the run's record; all of tilepipe's own where no record names one.

    Raises
    ------
    InputError
        When the record cannot be read, or names a pipeline that is not installed; or when the run is not finished.
    """
    from tilepipe.io.files.record import RECORD, STATE, read_record

    command = read_record(folder / RECORD).get("command") if (folder / RECORD).is_file() else None
    if command is None and (folder / STATE).is_dir():
        # a process that ended while it published has left some layers
        raise InputError(f"{folder}: holds an unfinished run; finish it first, see tilepipe status")
    if command is None:
        return [pipeline(name) for name in OWN]
    try:
        return [pipeline(command)]
    except InputError as error:
        raise InputError(f"{folder}: {error}") from None


def part(reference: str) -> Any:
    """What a pipeline names as ``module:name``, such as the function that draws its runs."""
    module, _, name = reference.partition(":")
    return getattr(import_module(module), name)


def complaints() -> list[str]:
    """One line for every package whose pipelines cannot be used because of their names; it names the package."""
    return [
        f"package {_package(point)} declares the pipeline '{name}', which is tilepipe's own; it is left out"
        for name in OWN
        for point in _foreign().get(name, [])
    ]


def forget() -> None:
    """Look for the pipelines of other packages anew, such as after one has been installed into a running process."""
    _foreign.cache_clear()
    _load.cache_clear()


@cache
def _foreign() -> dict[str, list[EntryPoint]]:
    """Entry points of other packages by name; an entry point found twice on the path counts once."""
    from importlib.metadata import entry_points

    found: dict[str, list[EntryPoint]] = defaultdict(list)
    for point in entry_points(group=GROUP):
        if (_package(point), point.value) not in [(_package(other), other.value) for other in found[point.name]]:
            found[point.name].append(point)
    return dict(found)


def _package(point: EntryPoint) -> str:
    return point.dist.name if point.dist else point.value


@cache
def _load(point: EntryPoint) -> Pipeline:
    from tilepipe.engine.pipeline import Pipeline

    where = f"pipeline '{point.name}' of the package {_package(point)}"
    try:
        found = point.load()
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0] or type(error).__name__
        raise InputError(
            f"{where} cannot be imported: {type(error).__name__}: {reason}; mend or uninstall the package"
        ) from error
    if not isinstance(found, Pipeline):
        raise InputError(f"{where} is no tilepipe pipeline but a {type(found).__name__}; mend {point.value}")
    if found.name != point.name:
        raise InputError(f"{where} calls itself '{found.name}'; the entry point and the pipeline must have one name")
    return found
