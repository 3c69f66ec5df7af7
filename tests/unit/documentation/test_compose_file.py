"""The compose file as text: its ports, its network, and commands that the programs have."""

import shlex
from collections.abc import Mapping
from typing import Any

import pytest
import typer
import yaml

from display_node.cli import app as display_node
from sensing_node.cli import app as sensing_node
from telepulse.cli.main import app as telepulse
from tests.support.nodes import ROOT

COMPOSE: dict[str, Any] = yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8"))
SERVICES: Mapping[str, Mapping[str, Any]] = COMPOSE["services"]
PROGRAMS = {"sensing-node": sensing_node, "display-node": display_node, "telepulse": telepulse}


def arguments_of(service: str) -> list[str]:
    command = SERVICES[service]["command"].replace("${TELEPULSE_SECONDS:-15}", "15")
    return shlex.split(command.replace("${TELEPULSE_LINK:-", "").replace('}"', '"'))


def test_pages_are_published_on_this_machine_alone_and_nodes_on_no_network_outside() -> None:
    ports = [port for service in SERVICES.values() for port in service.get("ports", ())]
    assert sorted(ports) == ["127.0.0.1:5006:5006", "127.0.0.1:5007:5007"]
    assert COMPOSE["networks"]["link"]["internal"] is True


@pytest.mark.parametrize("service", [name for name in SERVICES if name != "keys"])
def test_each_command_has_options_that_its_program_has(service: str) -> None:
    program, *arguments = arguments_of(service)
    context = typer.main.get_command(PROGRAMS[program])
    if program == "telepulse":
        name, *arguments = arguments
        found = context.get_command(typer.Context(context), name)  # type: ignore[attr-defined]
        assert found is not None
        context = found
    parsed = context.make_context(program, arguments, resilient_parsing=True)
    assert all(not each.startswith("-") for each in parsed.args), parsed.args
