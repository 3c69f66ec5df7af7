"""Whatever is given for an option: exit status 2, the reason on stderr, and no traceback."""

from pathlib import Path
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from display_node.cli import app as display_node
from protocol.errors import AddressError, SceneError, TelepulseError
from protocol.host.realtime import parse_realtime
from protocol.sockets import beyond_loopback, control_address
from sensing_node.cli import app as sensing_node
from telepulse.cli.main import app as telepulse
from telepulse.simulation.link_model import parse_link
from tests.support.nodes import RADIAL

# What a shell can pass on; a first dash would begin another option.
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), min_size=1)
words = texts.filter(lambda text: not text.startswith("-"))
numbers = st.sampled_from(["nan", "inf", "-inf", "-1", "0", "1e10", "1e999", "1_0_", "0x10", "९९e"])
addresses = words | words.map("tcp://{}".format) | words.map("tcp://127.0.0.1:{}".format)


def refused(app: Any, *arguments: str) -> str:
    """What a command says that cannot begin."""
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, SystemExit), repr(result.exception)
    assert result.exit_code == 2
    assert result.stderr.strip()
    assert "Traceback" not in result.output
    return result.stderr


def is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


@pytest.mark.parametrize(
    "command",
    [(telepulse, "demo"), (telepulse, "simulate"), (sensing_node, str(RADIAL))],
    ids=["demo", "simulate", "sensing-node"],
)
@settings(max_examples=15)
@given(seconds=numbers | words.filter(lambda text: not is_number(text)))
def test_seconds_that_are_none(command: tuple[Any, str], seconds: str) -> None:
    app, name = command
    assert "--seconds" in refused(app, name, "--seconds", seconds)


@settings(max_examples=25)
@given(text=words)
def test_a_link_that_is_none(text: str) -> None:
    assume(not _is_link(text))
    assert "--link" in refused(telepulse, "simulate", "--link", text)


def _is_link(text: str) -> bool:
    try:
        parse_link(text)
    except SceneError:
        return False
    return True


@settings(max_examples=25)
@given(text=words)
def test_measures_of_real_time_that_are_none(text: str) -> None:
    assume(not _is_asked(text))
    assert "--realtime" in refused(sensing_node, str(RADIAL), "--realtime", text)


def _is_asked(text: str) -> bool:
    try:
        parse_realtime(text)
    except TelepulseError:
        return False
    return True


@settings(max_examples=100)
@given(address=addresses)
def test_any_address_has_a_control_address_or_is_refused(address: str) -> None:
    beyond_loopback(address)
    try:
        control = control_address(address)
    except AddressError:
        return
    assert control.startswith(("tcp://", "ipc://"))
    assert control != address


@settings(max_examples=15)
@given(data=st.binary(max_size=100))
def test_a_file_that_is_no_scene(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = _file(tmp_path_factory, "scene.toml", data)
    for app in (display_node, sensing_node):
        assert str(path) in refused(app, str(path)).replace("\n", "")


@settings(max_examples=15)
@given(data=st.binary(max_size=60) | st.text(",;0123456789.\n", max_size=20).map(str.encode))
def test_a_file_that_is_no_table_of_loads(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = _file(tmp_path_factory, "loads.csv", data)
    result = CliRunner().invoke(telepulse, ["calibrate", str(path)])
    assert result.exit_code in (0, 2)
    assert result.exception is None or isinstance(result.exception, SystemExit)


def _file(factory: pytest.TempPathFactory, name: str, data: bytes) -> Path:
    path = factory.getbasetemp() / name
    path.write_bytes(data)
    return path
