"""A reader under test, and the law of readers: what a file holds is used, or refused by one line."""

from __future__ import annotations

import itertools
import shutil
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

import tilepipe
from tilepipe.errors import InputError

_ROOTS = tuple(str(Path(folder).resolve()) for folder in tilepipe.__path__)
_numbers = itertools.count()


@dataclass(frozen=True)
class Reader:
    """What is fuzzed.

    Attributes
    ----------
    name
        On the command line.
    seeds
        Makes the content of small valid files in an empty folder.
    read
        Writes a content into an empty folder, and reads it there as tilepipe does.
    mutate
        A change of a content that keeps most of its structure.
    refusal
        What it may raise: files of users are refused with an `InputError`; tilepipe's own are made again at a
        `ValueError`.
    """

    name: str
    seeds: Callable[[Path], list[bytes]]
    read: Callable[[bytes, Path], None]
    mutate: Callable[[bytes, Random], bytes]
    refusal: type[Exception] = InputError


def broken_law(reader: Reader, content: bytes, folder: Path) -> Exception | None:
    """The exception by which a reader breaks the law with a content; None where it does not."""
    # handles are kept by name, so each content gets a new one
    place = folder / str(next(_numbers))
    place.mkdir()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader.read(content, place)
    except reader.refusal as error:
        return None if is_one_line(error) else error
    except Exception as error:
        return error
    finally:
        shutil.rmtree(place)
    return None


def is_one_line(error: Exception) -> bool:
    return len(str(error).splitlines()) == 1


def assert_one_line(error: Exception) -> None:
    if not is_one_line(error):
        raise AssertionError(f"not one line: {error!r}") from error


def place_of(error: Exception) -> str:
    """Type of an exception and the last line of tilepipe that it came through: the same for the same mistake."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename.startswith(_ROOTS)]
    where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "harness"
    return f"{type(error).__name__} at {where}"
