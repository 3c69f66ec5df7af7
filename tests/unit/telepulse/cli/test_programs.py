"""Properties that the three programs share."""

import json
import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

import display_node.cli
import sensing_node.cli
import telepulse.cli.main
from tests.support.nodes import ROOT

PROGRAMS = (telepulse.cli.main.app, sensing_node.cli.app, display_node.cli.app)


@pytest.mark.parametrize("app", PROGRAMS)
def test_every_program_prints_its_version_and_can_be_completed_by_a_shell(app: typer.Typer) -> None:
    result = CliRunner().invoke(app, ["--version"])
    printed = f"telepulse {version('telepulse')}\n"
    assert (result.stdout, result.exit_code) == (printed, 0)
    options = [name for part in typer.main.get_command(app).params for name in part.opts]
    assert "--install-completion" in options


def test_the_help_of_telepulse_names_the_two_nodes() -> None:
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    nodes = scripts["scripts"].keys() - {"telepulse"}
    told = CliRunner().invoke(PROGRAMS[0], ["--help"]).stdout
    assert len(nodes) == 2
    assert all(node in told for node in nodes)


def test_a_dash_writes_json_alone_to_stdout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(PROGRAMS[0], ["simulate", "--seconds", "1", "--json", "-"])
    assert json.loads(result.stdout)["samples"]["sent"] == 1000
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "command",
    ["simulate", "export a.mcap --to csv", "bench", "experiment run a.toml --log a.jsonl"],
)
def test_a_level_that_the_log_does_not_have_is_refused(command: str) -> None:
    result = CliRunner().invoke(PROGRAMS[0], [*command.split(), "--log-level", "loud"])
    assert result.exit_code == 2
    assert result.stderr == ("telepulse: --log-level loud: there are debug, info, warning, error\n")
