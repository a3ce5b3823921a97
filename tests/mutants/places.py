"""Where a line stands: its statement, whether importing runs it, and what of it changes nothing that runs."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass

_Function = ast.FunctionDef | ast.AsyncFunctionDef
_Position = tuple[int, int]


_ASSERTIONS = {("zip", "strict"), ("dataclass", "frozen")}


@dataclass(frozen=True)
class Place:
    """A statement.

    Parameters
    ----------
    lines
        Of the statement without the statements in it: those of the header of a function or a loop.
    scope
        Where importing runs the statement: the lines of functions that can show what it does, of the function whose
        header it is, else of its class, else of the module; otherwise nothing.
    """

    lines: frozenset[int]
    scope: frozenset[int]


def place(tree: ast.Module, line: int) -> Place:
    """The statement that a line belongs to.

    Parameters
    ----------
    tree
        Of the module.
    line
        Counted from 1.
    """
    around: list[ast.AST] = [tree]
    while (inner := next((each for each in _parts(around[-1]) if line in _span(each)), None)) is not None:
        around.append(inner)
    statement = around[-1]
    own = set(_span(statement)) if statement is not tree else {line}
    own -= {each for part in _parts(statement) for each in _span(part)}
    if any(isinstance(each, _Function) for each in around[1:-1]):
        return Place(frozenset(own), frozenset())
    scopes = [each for each in reversed(around) if isinstance(each, (_Function, ast.ClassDef, ast.Module))]
    return Place(frozenset(own), next(filter(None, map(_lines_of_functions, scopes)), frozenset()))


def of_no_effect(tree: ast.Module, text: str) -> list[tuple[_Position, _Position]]:
    """Begin and end (line from 1, column of characters) of what changes nothing that a right program does.

    These are annotations, which ``from __future__ import annotations`` leaves as text, what only checkers of
    types read, below ``if TYPE_CHECKING``, and two assertions: ``strict`` of `zip`, that lengths agree, and ``frozen``
    of `dataclass`, that nobody changes a value.
    """
    found: list[ast.AST] = []
    for node in ast.walk(tree):
        if isinstance(node, (ast.arg, ast.AnnAssign)) and node.annotation is not None:
            found.append(node.annotation)
        elif isinstance(node, _Function) and node.returns is not None:
            found.append(node.returns)
        elif isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            found.append(node)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            found.extend(each.value for each in node.keywords if (node.func.id, each.arg) in _ASSERTIONS)
    lines = text.splitlines()
    return [(_characters(lines, *_begin(node)), _characters(lines, *_end(node))) for node in found]


def _begin(node: ast.AST) -> _Position:
    return node.lineno, node.col_offset  # type: ignore[attr-defined]


def _end(node: ast.AST) -> _Position:
    return node.end_lineno, node.end_col_offset  # type: ignore[attr-defined]


def _characters(lines: list[str], line: int, column: int) -> _Position:
    """A place whose column counts bytes, as `ast` does, with one that counts characters."""
    return line, len(lines[line - 1].encode()[:column].decode())


def _parts(node: ast.AST) -> Iterator[ast.AST]:
    """Statements in a statement, clauses included."""
    for each in ast.iter_child_nodes(node):
        if isinstance(each, (ast.stmt, ast.ExceptHandler, ast.match_case)):
            yield each


def _span(node: ast.AST) -> range:
    """Lines from the first decorator to the end."""
    if isinstance(node, ast.match_case):
        return range(node.pattern.lineno, _end(node.body[-1])[0] + 1)
    first = min([_begin(node)[0], *(each.lineno for each in getattr(node, "decorator_list", []))])
    return range(first, _end(node)[0] + 1)


def _lines_of_functions(node: ast.AST) -> frozenset[int]:
    """Lines that run only when a function in this node, or the node itself, is called."""
    functions = [each for each in ast.walk(node) if isinstance(each, _Function)]
    return frozenset(line for each in functions for part in each.body for line in _span(part))
