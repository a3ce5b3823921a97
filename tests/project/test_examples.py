"""The examples in docstrings run, say what they print, and do not become fewer."""

from __future__ import annotations

import ast
import doctest
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ROOT / "kernels" / "tilepipe_kernels", ROOT / "tilepipe"
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE

AT_LEAST = 306
"""Public functions and classes with an example.  A reader learns a function from its example first: a new one brings
its own, and whoever raises the number writes it here, so that examples are not lost unnoticed."""


def docstrings(parent: ast.AST, name: str) -> Iterator[tuple[str, str, int]]:
    """Name, docstring and its line, of a module and all that it defines."""
    if isinstance(parent, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(parent):
        text = parent.body[0].value  # type: ignore[attr-defined]
        yield name, text.value, text.lineno
    for node in ast.iter_child_nodes(parent):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield from docstrings(node, f"{name}.{node.name}")


def examples() -> Iterator[doctest.DocTest]:
    """Docstrings with examples; they are read from the sources, since doctest does not see compiled functions."""
    parser = doctest.DocTestParser()
    for package in PACKAGES:
        for path in sorted(package.rglob("*.py")):
            module = ".".join(path.relative_to(package.parent).with_suffix("").parts).removesuffix(".__init__")
            if "device" in path.relative_to(package).parts[:-1]:
                continue  # the CUDA form of a kernel has the docstring of its host form
            for name, text, line in docstrings(ast.parse(path.read_text(encoding="utf-8")), module):
                # its own names only: an example imports what it uses, as its reader must
                test = parser.get_doctest(text, {"__name__": "__main__"}, name, str(path), line - 1)
                if test.examples:
                    yield test


EXAMPLES = list(examples())


@pytest.mark.parametrize("example", EXAMPLES, ids=[example.name for example in EXAMPLES])
def test_example(example: doctest.DocTest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    report: list[str] = []
    doctest.DocTestRunner(optionflags=FLAGS).run(example, out=report.append)
    assert not report, "".join(report)


def test_examples_stand_in_their_section() -> None:
    for example in EXAMPLES:
        text, _, _ = (example.docstring or "").partition(">>>")
        assert [line.strip() for line in text.splitlines()].count("Examples") == 1, f"{example.name}: Examples?"


def test_examples_do_not_become_fewer() -> None:
    public = [each.name for each in EXAMPLES if not any(part.startswith("_") for part in each.name.split("."))]
    assert len(public) >= AT_LEAST, f"only {len(public)} public functions and classes have an example"
