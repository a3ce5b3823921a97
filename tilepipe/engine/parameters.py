"""Named values become checked parameters of a pipeline, or one line that says what to do."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from tilepipe.errors import InputError

Parameters = TypeVar("Parameters", bound=BaseModel)


def checked_parameters(kind: type[Parameters], values: Mapping[str, Any]) -> Parameters:
    """Parameters from named values, such as those of ``--set name=value`` or of a record.

    Parameters
    ----------
    kind
        Class of the parameters.
    values
        Values by name; what is not named keeps its default.

    Raises
    ------
    InputError
        When a name is unknown or a value is out of its range; names the parameter and says what to do.

    Examples
    --------
    >>> import tilepipe
    >>> from tilepipe.engine.parameters import checked_parameters
    >>> checked_parameters(tilepipe.StreetParameters, {"line_width": "7.5"}).line_width
    7.5
    >>> checked_parameters(tilepipe.StreetParameters, {"sigma": 2.5})
    Traceback (most recent call last):
        ...
    tilepipe.errors.InputError: parameter 'sigma' is unknown; did you mean 'line_sigma'?
    """
    try:
        return kind(**values)
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        if first["type"] == "extra_forbidden":
            raise InputError(f"parameter '{name}' is unknown; {_suggestion(kind, name)}") from None
        message = first["msg"].removeprefix("Value error, ")
        prefix = f"parameter {name}={first['input']!r}: " if name else ""
        raise InputError(f"{prefix}{message[0].lower()}{message[1:]}") from None


def _suggestion(kind: type[BaseModel], name: str) -> str:
    known = list(kind.model_fields)
    close = difflib.get_close_matches(name, known, n=1)
    return f"did you mean '{close[0]}'?" if close else f"known are: {', '.join(known)}"
