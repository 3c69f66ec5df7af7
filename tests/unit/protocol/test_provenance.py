import pytest

from protocol.errors import WireError
from protocol.provenance import MAX_BYTES, REDACTED, read_provenance, redact, redact_command


@pytest.mark.parametrize("data", [b"", b"[]", b"\xff", b"{", b'"' + b"x" * MAX_BYTES + b'"'])
def test_hostile_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(WireError):
        read_provenance(data)


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
