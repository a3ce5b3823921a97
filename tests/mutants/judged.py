"""The list of mutants that a person has found to change nothing that anybody could see."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.mutants.making import Mutant

LIST = Path(__file__).with_name("judged.toml")


@dataclass(frozen=True)
class Judgement:
    """Changes of one line that change nothing, by its text, so that it stays true where the file grows.

    Parameters
    ----------
    path
        Of the file, relative to the checkout.
    before
        The line as it is.
    after
        The line as it may be; where none is named, any change of it will do.
    why
        In one line.
    """

    path: str
    before: str
    why: str
    after: Sequence[str] = ()

    def covers(self, mutant: Mutant) -> bool:
        """Whether the mutant is one of these changes."""
        same = (mutant.path, mutant.before) == (self.path, self.before)
        return same and (not self.after or mutant.after in self.after)


def judgements(path: Path = LIST) -> list[Judgement]:
    """All that are in the list."""
    return [Judgement(**entry) for entry in tomllib.loads(path.read_text()).get("equivalent", [])]


def equivalent(mutant: Mutant, known: Iterable[Judgement]) -> Judgement | None:
    """The judgement by which a mutant changes nothing."""
    return next((each for each in known if each.covers(mutant)), None)


def outdated(root: Path, known: Iterable[Judgement]) -> list[Judgement]:
    """Judgements whose line is no more."""
    return [each for each in known if not (root / each.path).exists() or each.before not in _flat(root / each.path)]


def _flat(path: Path) -> str:
    return " ".join(path.read_text().split())
