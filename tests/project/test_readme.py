"""README.md says what the code does: parameters, columns, exit codes, command lines and examples."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import typer

from tests.project.readme import README, code_blocks, commands, parameter_table, with_tables
from tilepipe import cli
from tilepipe.cli import pipelines
from tilepipe.pipelines.edges.parameters import edge_parameters
from tilepipe.pipelines.edges.tables import EDGE_COLUMNS, NEVATIA_BABU_COLUMNS
from tilepipe.pipelines.objects.building_table import BUILDING_COLUMNS
from tilepipe.pipelines.objects.parameters import object_parameters
from tilepipe.pipelines.objects.pass_borders import BOUNDARY_COLUMNS, OBJECT_COLUMNS
from tilepipe.pipelines.streets.parameters import StreetParameters, street_parameters
from tilepipe.pipelines.streets.tables import COLUMNS
from tilepipe.synthetic import City, write_city

TEXT = README.read_text(encoding="utf-8")
COMMANDS = commands(TEXT, "tilepipe")


def test_parameters_are_those_of_the_model() -> None:
    assert with_tables(TEXT) == TEXT, "run scripts/readme-parameters"


def test_table_takes_units_out_of_the_meaning() -> None:
    rows = {row.split("`")[1]: row for row in parameter_table(StreetParameters).splitlines()[2:]}
    assert rows["maximum_contour"].endswith("| m | longest contour of a street region |")
    assert rows["gradient_sigma"].endswith("| m | Gaussian of the gradient (σ) |")
    assert rows["tolerance"].split(" | ")[2] == "grey"


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_commands_parse(words: list[str]) -> None:
    name, *arguments = words
    group = typer.main.get_command(cli.app)
    command = group.get_command(typer.Context(group), name)  # type: ignore[attr-defined]
    assert command is not None, f"tilepipe has no command {name}"
    context = command.make_context(name, arguments)
    checked = {"objects": object_parameters, "edges": edge_parameters}.get(name, street_parameters)
    checked(pipelines.assignments(context.params.get("set_") or []))


def test_every_command_is_shown() -> None:
    names = {command.callback.__name__ for command in cli.app.registered_commands if command.callback}
    assert names <= {words[0] for words in COMMANDS}


def test_columns_are_those_of_the_tables() -> None:
    streets, _, rest = TEXT.partition("## Objects from heights")
    edges = rest.partition("## Edges from photographs")[2].partition("## Set up")[0]
    for part, columns in ((streets, COLUMNS), (edges, EDGE_COLUMNS)):
        assert re.findall(r"^\| `(\w+)` \|", part, re.MULTILINE) == list(columns)


def test_exit_codes_are_those_of_the_command_line() -> None:
    codes = [int(code) for code in re.findall(r"^\| (\d+) \|", TEXT.partition("## Exit codes")[2], re.MULTILINE)]
    assert codes == [cli.DONE, cli.FAILED, cli.BAD_INPUT, cli.INTERRUPTED]


def test_named_files_exist() -> None:
    names = re.findall(r"\]\((?!http)([^)#]+)\)", TEXT) + re.findall(r"`((?:scripts|notebooks|docs)/[\w.-]+)`", TEXT)
    assert names and not [name for name in names if not (README.parent / name).exists()]


def test_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_city(tmp_path, City(rows=512, columns=512), layers=("intensity", "height"), tile=512)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in code_blocks(TEXT, "python"):
        exec(block, names)  # the examples follow one another, as in a session
    (record,) = code_blocks(TEXT, "toml")
    (tmp_path / "city.toml").write_text(record)
    assert tomllib.loads(record)["command"] == "streets"
    pipelines.run_record(pipelines.load_record(tmp_path / "city.toml", None), overwrite=True, quiet=True)
    assert (tmp_path / tomllib.loads(record)["out"] / "centerlines.parquet").is_file()


def test_other_columns_are_named() -> None:
    for name in (*OBJECT_COLUMNS, *BOUNDARY_COLUMNS, *BUILDING_COLUMNS, *NEVATIA_BABU_COLUMNS):
        assert f"`{name}`" in TEXT
