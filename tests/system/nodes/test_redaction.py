"""No secret of a scene or a command line gets into what results carry."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from display_node.scene import DisplayScene
from protocol.config.scene import load_section
from protocol.provenance import REDACTED, collect, redact, redact_command
from sensing_node.scene import SensingScene
from telepulse.experiment.session import load_plan
from telepulse.simulation.link_model import LinkScene
from tests.support.nodes import RADIAL, ROOT, run

SECRET = "hunter2"
DRIVE = f"""
[display.drive]
kind = "tmcl"
interface = "remote"
channel = "ws://lab:{SECRET}@adapter.local:54701/"

[display.drive.options]
cloud_token = "{SECRET}"
api_key = "{SECRET}"
app_name = "bench"
dsn = "a=1;PWD={SECRET}"
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene whose drive is behind an adapter that asks for credentials."""
    path = tmp_path / "scene.toml"
    path.write_text(RADIAL.read_text(encoding="utf-8") + DRIVE, encoding="utf-8")
    return path


def test_provenance_has_a_scenes_options_without_their_secrets(
    scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["display-node", "--connect", f"tcp://a:{SECRET}@host:5555"])
    found = collect(scene, {"display": load_section(scene, "display", DisplayScene)})
    assert SECRET not in found.to_bytes().decode()
    assert found.command[2] == f"tcp://{REDACTED}@host:5555"
    for drive in (found.scene["tables"]["display"]["drive"], found.effective["display"]["drive"]):
        assert drive["channel"] == f"ws://{REDACTED}@adapter.local:54701/"
        assert drive["options"] == {
            "cloud_token": REDACTED,
            "api_key": REDACTED,
            "app_name": "bench",
            "dsn": f"a=1;PWD={REDACTED}",
        }


def test_neither_a_summary_nor_an_experiments_log_has_a_secret(scene: Path) -> None:
    out, session = scene.parent / "out.json", scene.parent / "session.toml"
    command = ("simulate", str(scene), "--seconds", "1", "--json", str(out))
    assert run("telepulse", *command).returncode == 0
    example = (ROOT / "telepulse" / "experiment" / "example.toml").read_text(encoding="utf-8")
    session.write_text(re.sub("(?m)^scene = .*", f'scene = "{scene}"', example), encoding="utf-8")
    for text in (out.read_text(encoding="utf-8"), json.dumps(load_plan(session).tables)):
        assert SECRET not in text
        assert REDACTED in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("rfc2217://me:pw@host:2217", f"rfc2217://{REDACTED}@host:2217"),
        ("tcp://*:5555", "tcp://*:5555"),
        (
            "socket://host:1?logging=debug&password=pw",
            f"socket://host:1?logging=debug&password={REDACTED}",
        ),
        ("keys/finger.key", "keys/finger.key"),
        ("delay=20ms,cut.from=6s", "delay=20ms,cut.from=6s"),
        ("me@host", "me@host"),
    ],
)
def test_texts(text: str, expected: str) -> None:
    assert redact(text) == expected


def test_the_value_after_an_option_with_a_secrets_name() -> None:
    given = ["--password", "pw", "--key", "keys/finger.key", "--api-key=pw", "--quiet"]
    expected = ["--password", REDACTED, "--key", "keys/finger.key", f"--api-key={REDACTED}"]
    assert redact_command(given) == [*expected, "--quiet"]


def names(schema: type[BaseModel]) -> Iterator[str]:
    for name, field in schema.model_fields.items():
        yield field.alias or name
        for part in (field.annotation, *get_args(field.annotation)):
            for inner in (part, *get_args(part)):
                if isinstance(inner, type) and issubclass(inner, BaseModel):
                    yield from names(inner)


@pytest.mark.parametrize("schema", [SensingScene, DisplayScene, LinkScene])
def test_no_key_of_a_scene_is_taken_for_a_secret(schema: type[BaseModel]) -> None:
    table: dict[str, Any] = dict.fromkeys(names(schema), 1)
    assert redact(table) == table
    assert json.dumps(table)


def test_a_scene_without_secrets_is_kept_as_it_is() -> None:
    found = collect(RADIAL)
    assert REDACTED not in found.to_bytes().decode()
