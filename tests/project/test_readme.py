"""README.md is one short page, and what it names is there."""

from __future__ import annotations

import re

from tests.project.pages import README, ROOT, code_blocks, text_of

TEXT = text_of(README)


def test_it_is_short() -> None:
    assert README.stat().st_size <= 8192


def test_a_picture_of_every_pipeline_is_small() -> None:
    pictures = [ROOT / name for name in re.findall(r"!\[[^]]+\]\(([^)]+)\)", TEXT)]
    assert [picture.stem for picture in pictures] == ["streets", "objects", "edges"]
    assert all(picture.stat().st_size <= 250_000 for picture in pictures)


def test_named_files_exist() -> None:
    names = re.findall(r"\]\((?!http)([^)#]+)\)", TEXT) + re.findall(r"`((?:scripts|notebooks|docs)/[\w./-]+)`", TEXT)
    assert names and not [name for name in names if not (ROOT / name).exists() and "_build" not in name]


def test_python_is_six_lines() -> None:
    (block,) = code_blocks(TEXT, "python")
    assert len(block.splitlines()) == 6
