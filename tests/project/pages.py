"""README.md and the pages of the documentation, with the commands and the examples that they hold."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
DOCS = ROOT / "docs"
PAGES = [README, *sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)]


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def code_blocks(text: str, language: str) -> list[str]:
    """Blocks of code that a build does not run."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def code_cells(text: str) -> list[str]:
    """Blocks of code that the build of the documentation runs, without their options."""
    cells = re.findall(r"^```\{code-cell\} ipython3\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [re.sub(r"\A(:\w+:[^\n]*\n)+\n?", "", cell) for cell in cells]


def commands(text: str, program: str) -> list[list[str]]:
    """Arguments of every command line of a program, in blocks and cells of code and inside the text."""
    blocks = code_blocks(text, "bash") + [cell for cell in code_cells(text) if cell.startswith("%%bash")]
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    lines += re.findall(r"`([^`\n]+)`", text)
    split = [shlex.split(line, comments=True) for line in lines if line.startswith(f"{program} ")]
    return [words[1:] for words in split]
