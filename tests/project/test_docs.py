"""The documentation says what the code does: commands, parameters, columns, exit codes and examples."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path
from urllib.parse import urlsplit

import pytest
import typer

import tilepipe
from docs.from_code import columns, commands, kernels, parameters
from tests.project import pages
from tilepipe import cli
from tilepipe.cli import pipelines, records
from tilepipe.engine.parameters import checked_parameters
from tilepipe.pipelines import registry
from tilepipe.synthetic import City, write_city

COMMANDS = sorted({tuple(words) for page in pages.PAGES for words in pages.commands(pages.text_of(page), "tilepipe")})
WITH_PYTHON = [page for page in pages.PAGES if pages.code_blocks(pages.text_of(page), "python")]
names_of_pages = {"ids": lambda page: str(page.relative_to(pages.ROOT))}


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_commands_parse(words: tuple[str, ...]) -> None:
    name, *arguments = words
    if name.isupper() or name.startswith("-"):
        return  # the form of a command line, not one
    group = commands.command_group()
    command = group.get_command(typer.Context(group), name)
    assert command is not None, f"tilepipe has no command {name}"
    if not arguments:
        return  # the name of the command alone
    context = command.make_context(name, arguments)
    if name in parameters.MODELS:
        checked_parameters(parameters.MODELS[name], pipelines.assignments(context.params.get("set_") or []))


def test_every_command_is_shown() -> None:
    names = {command.callback.__name__ for command in cli.app.registered_commands if command.callback}
    names |= set(registry.OWN)
    assert names <= {words[0] for words in COMMANDS}
    sections = commands.command_sections()
    assert all(f"\n## {name}\n" in sections for name in names)
    assert "| `--tile <int>` | `2048` | Tile size in pixels. |" in sections


@pytest.mark.parametrize("page", WITH_PYTHON, **names_of_pages)
def test_examples_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_city(tmp_path, City(rows=512, columns=512), layers=("intensity", "height"), tile=512)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in pages.code_blocks(pages.text_of(page), "python"):
        # the examples of a page follow one another, as in a session
        exec(compile(block, str(page), "exec", dont_inherit=True), names)


def test_cells_that_the_build_runs_are_python() -> None:
    cells = [cell for page in pages.PAGES for cell in pages.code_cells(pages.text_of(page))]
    assert cells
    for cell in cells:
        if not cell.startswith("%%"):
            ast.parse(cell)


def test_the_record_of_an_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_city(tmp_path, City(rows=512, columns=512), layers=("intensity", "height"), tile=512)
    monkeypatch.chdir(tmp_path)
    (record,) = pages.code_blocks(pages.text_of(pages.DOCS / "reference" / "record.md"), "toml")
    (tmp_path / "city.toml").write_text(record)
    assert tomllib.loads(record)["command"] == "streets"
    records.run_record(records.load_record(tmp_path / "city.toml", None), overwrite=True, quiet=True)
    assert (tmp_path / tomllib.loads(record)["out"] / "centerlines.parquet").is_file()


def test_table_takes_units_out_of_the_meaning() -> None:
    table = parameters.parameter_table(parameters.MODELS["streets"])
    rows = {row.split("`")[1]: row for row in table.splitlines()[2:]}
    assert rows["maximum_contour"].endswith("| m | longest contour of a street region |")
    assert rows["gradient_sigma"].endswith("| m | Gaussian of the gradient (σ) |")
    assert rows["tolerance"].split(" | ")[2] == "grey"


def test_every_parameter_and_column_is_described() -> None:
    for model in parameters.MODELS.values():
        assert all(field.description for field in model.model_fields.values())
    for table in columns.TABLES.values():
        assert table.meaning and all(column.meaning for column in table.columns.values())


def test_every_table_has_its_place() -> None:
    text = pages.text_of(pages.DOCS / "reference" / "layers.md")
    shown = re.findall(r"\{column-table\} (\w+)", text)
    assert {*shown, "skeleton"} == set(columns.TABLES)  # the two tables of centerlines have the same columns
    text = pages.text_of(pages.DOCS / "reference" / "parameters.md")
    assert re.findall(r"\{parameter-table\} (\w+)", text) == list(parameters.MODELS)


def test_exit_codes_are_those_of_the_command_line() -> None:
    assert list(commands.EXIT_CODES) == [cli.DONE, cli.FAILED, cli.BAD_INPUT, cli.INTERRUPTED]


def test_everything_that_python_exports_is_described() -> None:
    text = pages.text_of(pages.DOCS / "reference" / "python.md")
    listed = re.findall(r"^\.\. auto(?:function|class|exception):: (\w+)(?:\(\))?$", text, re.MULTILINE)
    assert sorted(listed) == sorted(set(tilepipe.__all__) - {"__version__"})


def test_kernels_have_pages_with_their_public_functions() -> None:
    (package,) = (package for package in kernels.packages() if package.__name__.endswith(".regions"))
    found = {name for module in kernels.modules(package) for _, name in kernels.public(module)}
    assert {"grow_regions", "split", "LeafTable"} <= found and "in_order" not in found


def test_outside_addresses_are_whole() -> None:
    for page in pages.PAGES:
        for address in re.findall(r"https?://[^\s)>`]+", pages.text_of(page)):
            parts = urlsplit(address)
            assert parts.scheme == "https" and "." in parts.netloc, f"{page.name}: {address}"
