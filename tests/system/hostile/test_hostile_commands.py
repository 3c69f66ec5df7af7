"""Invalid options: exit status 2, the reason on stderr, and no traceback."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from display_node.cli import app as display_node
from protocol.errors import AddressError, TelepulseError
from protocol.host.realtime import parse_realtime
from protocol.sockets import beyond_loopback, control_address
from sensing_node.cli import app as sensing_node
from telepulse.cli.main import app as telepulse
from telepulse.simulation.link_scene import parse_link
from tests.support.nodes import RADIAL

# What a shell can pass on; a first dash would begin another option.
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), min_size=1)
words = texts.filter(lambda text: not text.startswith("-"))
numbers = st.sampled_from(["nan", "inf", "-inf", "-1", "0", "1e10", "1e999", "1_0_", "0x10", "९९e"])
addresses = words | words.map("tcp://{}".format) | words.map("tcp://127.0.0.1:{}".format)


def refused(app: Any, *arguments: str) -> str:
    """Return the error message of a command that does not start."""
    result = CliRunner().invoke(app, arguments)
    assert isinstance(result.exception, SystemExit), repr(result.exception)
    assert result.exit_code == 2
    assert result.stderr.strip()
    assert "Traceback" not in result.output
    return result.stderr


def valid(parse: Callable[[str], object], text: str) -> bool:
    try:
        parse(text)
    except (ValueError, TelepulseError):
        return False
    return True


@pytest.mark.parametrize(
    "command",
    [(telepulse, "demo"), (telepulse, "simulate"), (sensing_node, str(RADIAL))],
    ids=["demo", "simulate", "sensing-node"],
)
@settings(max_examples=15)
@given(seconds=numbers | words.filter(lambda text: not valid(float, text)))
def test_invalid_seconds_are_refused(command: tuple[Any, str], seconds: str) -> None:
    app, name = command
    assert "--seconds" in refused(app, name, "--seconds", seconds)


@pytest.mark.parametrize(
    ("parse", "app", "arguments"),
    [
        (parse_link, telepulse, ("simulate", "--link")),
        (parse_realtime, sensing_node, (str(RADIAL), "--realtime")),
    ],
    ids=["link", "real-time measures"],
)
@settings(max_examples=25)
@given(text=words)
def test_invalid_links_and_real_time_measures_are_refused(
    parse: Callable[[str], object], app: Any, arguments: tuple[str, ...], text: str
) -> None:
    assume(not valid(parse, text))
    assert arguments[-1] in refused(app, *arguments, text)


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
def test_a_file_that_is_no_scene_is_refused(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = tmp_path_factory.getbasetemp() / "scene.toml"
    path.write_bytes(data)
    for app in (display_node, sensing_node):
        assert str(path) in refused(app, str(path)).replace("\n", "")
