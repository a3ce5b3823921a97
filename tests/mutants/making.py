"""All mutants of a package by the operators of cosmic-ray, and a sample of them."""

from __future__ import annotations

import ast
import difflib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

from tests.mutants.places import of_no_effect

_IDENTITY = ("Eq_Is", "Is_Eq", "NotEq_IsNot", "IsNot_NotEq")
"""Equality for identity and back: which equal constants are one object is up to the interpreter."""


@dataclass(frozen=True)
class Mutant:
    """One change of one file.

    Parameters
    ----------
    path
        Of the file, relative to the checkout.
    line
        Of the change, counted from 1.
    operator
        Of cosmic-ray.
    occurrence
        Which of the places that the operator finds in the file.
    before, after
        The lines that differ, as they were and as they are; empty until the mutant is made.
    """

    path: str
    line: int
    operator: str
    occurrence: int
    before: str = ""
    after: str = ""


def mutants(root: Path, path: str) -> list[Mutant]:
    """All mutants of a file, but those that by construction change nothing that runs."""
    from cosmic_ray.ast import ast_nodes, get_ast

    text = (root / path).read_text()
    left_out = of_no_effect(ast.parse(text), text)
    nodes = list(ast_nodes(get_ast(text)))
    found = []
    for name, operator in _operators().items():
        places = (place for node in nodes for place in operator.mutation_positions(node))
        for occurrence, (begin, _) in enumerate(places):
            if not any(first <= begin < last for first, last in left_out):
                found.append(Mutant(path, begin[0], name, occurrence))
    return sorted(found, key=lambda mutant: (mutant.line, mutant.operator, mutant.occurrence))


def made(root: Path, mutant: Mutant) -> tuple[Mutant, str] | None:
    """A mutant with its lines, and the text of its file; nothing where that is no Python, or no other."""
    from cosmic_ray.mutating import mutate_code

    text = (root / mutant.path).read_text()
    mutated = mutate_code(text, _operators()[mutant.operator], mutant.occurrence)
    try:
        if mutated is None or ast.dump(ast.parse(mutated)) == ast.dump(ast.parse(text)):
            return None
    except SyntaxError:
        return None
    changes = [each for each in difflib.ndiff(text.splitlines(), mutated.splitlines()) if each[:2] in ("- ", "+ ")]
    before, after = (
        " ".join(" ".join(each[2:].split()) for each in changes if each.startswith(sign)) for sign in ("- ", "+ ")
    )
    return replace(mutant, before=before, after=after), mutated


def sample(root: Path, found: Iterable[Mutant], size: int, seed: int) -> Iterator[tuple[Mutant, str]]:
    """So many mutants, of each file in proportion to all of its own; the same for the same seed.

    Parameters
    ----------
    root
        Of the checkout.
    found
        All mutants.
    size
        Number of mutants to make.
    seed
        Decides which.
    """
    by_file: dict[str, list[Mutant]] = {}
    for mutant in found:
        by_file.setdefault(mutant.path, []).append(mutant)
    shares = _shares({path: len(each) for path, each in by_file.items()}, size)
    for path, each in by_file.items():
        Random(f"{seed} {path}").shuffle(each)
        good = filter(None, (made(root, mutant) for mutant in each))
        yield from (mutant for mutant, _ in zip(good, range(shares[path]), strict=False))


def _shares(counts: dict[str, int], size: int) -> dict[str, int]:
    """Whole shares by the largest remainder."""
    total = sum(counts.values())
    exact = {path: min(size, total) * count / total for path, count in counts.items()}
    shares = {path: int(each) for path, each in exact.items()}
    left = min(size, total) - sum(shares.values())
    for path in sorted(exact, key=lambda path: (shares[path] - exact[path], path))[:left]:
        shares[path] += 1
    return shares


@cache
def _operators() -> dict[str, Any]:
    """Operators of cosmic-ray that need no arguments, by name, without those that swap equality and identity."""
    from cosmic_ray.plugins import get_operator, operator_names

    found = {name.partition("/")[2]: get_operator(name) for name in operator_names()}
    return {
        name: operator()
        for name, operator in found.items()
        if not operator.arguments() and not name.endswith(_IDENTITY)
    }
