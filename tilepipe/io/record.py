"""The files beside the layers of a run: its record, which says everything as resolved, and its timings."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from tilepipe.errors import InputError

RECORD = "run.toml"
TIMINGS = "timings.json"


def read_record(path: Path) -> dict[str, Any]:
    """Read a record.

    Raises
    ------
    InputError
        When the file is missing or is no TOML.
    """
    try:
        return tomllib.loads(path.read_text())
    except FileNotFoundError:
        raise InputError(f"{path}: no such file; name the run.toml of a run") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); name the run.toml of a run") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: is no valid TOML ({error})") from error
