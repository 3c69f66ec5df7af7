"""The compose file as text: its ports, its network, and commands that the programs have."""

import json
import shlex
import tomllib
from collections.abc import Mapping
from fnmatch import fnmatch
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
OURS = [name for name, service in SERVICES.items() if service["image"] == "telepulse"]
DISPLAYS = ["display", "display-wan"]
MONITORING = ROOT / "docs" / "monitoring"
PROGRAMS = {"sensing-node": sensing_node, "display-node": display_node, "telepulse": telepulse}


def arguments_of(service: str) -> list[str]:
    command = SERVICES[service]["command"].replace("${TELEPULSE_SECONDS:-15}", "15")
    return shlex.split(command.replace("${TELEPULSE_LINK:-", "").replace('}"', '"'))


def test_pages_are_published_on_this_machine_alone_and_nodes_on_no_network_outside() -> None:
    ports = [port for service in SERVICES.values() for port in service.get("ports", ())]
    assert sorted(ports) == [f"127.0.0.1:{port}:{port}" for port in (3000, 5006, 5007, 9090)]
    assert COMPOSE["networks"]["link"]["internal"] is True


@pytest.mark.parametrize("service", [name for name in OURS if name != "keys"])
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


def test_the_image_is_built_from_all_that_the_wheel_includes() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    lines = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    sent = [line.removeprefix("!") for line in lines if line.startswith("!")]
    for needed in (*wheel["packages"], *wheel["force-include"]):
        assert any(fnmatch(needed, each) or needed.startswith(f"{each}/") for each in sent), needed


@pytest.mark.parametrize("service", ["sensing", *DISPLAYS])
def test_a_nodes_health_is_read_where_it_serves_its_figures(service: str) -> None:
    arguments = arguments_of(service)
    _, port = arguments[arguments.index("--metrics") + 1].split(":")
    *_, program = SERVICES[service]["healthcheck"]["test"]
    assert f"http://127.0.0.1:{port}/metrics" in program


def test_all_but_the_displays_and_the_keys_start_again_after_a_failure() -> None:
    # A display that starts again has forgotten the fault that it had latched.
    stay = {name for name, service in SERVICES.items() if service.get("restart", "no") == "no"}
    assert stay == {*DISPLAYS, "keys"}


def test_prometheus_and_grafana_read_the_files_that_are_mounted() -> None:
    mounts = dict(each.split(":")[:2] for each in SERVICES["grafana"]["volumes"])
    for source in mounts:
        assert (ROOT / source).is_dir()
    shown = mounts["./docs/monitoring"]
    home = SERVICES["grafana"]["environment"]["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"]
    dashboard = json.loads((MONITORING / home.removeprefix(f"{shown}/")).read_text("utf-8"))
    assert dashboard["title"] == "telepulse"
    provisioning = MONITORING / "compose" / "grafana"
    (provider,) = yaml.safe_load(
        (provisioning / "dashboards" / "telepulse.yml").read_text("utf-8")
    )["providers"]
    assert provider["options"]["path"] == shown
    (data,) = yaml.safe_load((provisioning / "datasources" / "telepulse.yml").read_text("utf-8"))[
        "datasources"
    ]
    assert data["url"] == "http://prometheus:9090"
    (scraped,) = yaml.safe_load((MONITORING / "compose" / "prometheus.yml").read_text("utf-8"))[
        "scrape_configs"
    ]
    (targets,) = (each["targets"] for each in scraped["static_configs"])
    for target in targets:
        name, port = target.split(":")
        # A node answers requests that name its host.
        assert SERVICES[name]["hostname"] == name
        assert f"0.0.0.0:{port}" in arguments_of(name)
