import json
from collections.abc import Iterator
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from display_node.scene import DisplayScene
from protocol.errors import WireError
from protocol.provenance import MAX_BYTES, REDACTED, read_provenance, redact, redact_command
from sensing_node.scene import SensingScene
from telepulse.simulation.link_scene import LinkScene


@pytest.mark.parametrize("data", [b"", b"[]", b"\xff", b"{", b'"' + b"x" * MAX_BYTES + b'"'])
def test_hostile_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(WireError):
        read_provenance(data)


def test_tables_of_a_message_are_text() -> None:
    assert read_provenance(b'{"a": "b", "c": {"d": 1}}') == {"a": "b", "c": '{"d": 1}'}


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
def test_secrets_of_a_text_are_redacted(text: str, expected: str) -> None:
    assert redact(text) == expected


def test_the_value_of_an_option_with_a_secret_name_is_redacted() -> None:
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
