"""Control messages on the wire."""

import math

import msgpack
import pytest

from protocol.errors import WireError
from protocol.tactile import ElasticLayer
from protocol.wire.messages import (
    MAX_CONTROL_BYTES,
    Bye,
    ClockReply,
    Control,
    DisplayReport,
    Hello,
    Welcome,
    decode_control,
    encode_control,
)
from protocol.wire.stream import Channel, StreamDescription
from tests.support.message_examples import CONTROL, DESCRIPTION

REPORT = [1, "report", 7, "me", 90, 6, 4, 1.5, 2.5, 40.0, 0.25]
CLOCK = [1, "clock", 7, 1, 2, 3]
WELCOME = [1, "welcome", 7, 0, DESCRIPTION.to_wire()]
NAN = math.nan


def cause_of(data: bytes) -> str:
    with pytest.raises(WireError) as caught:
        decode_control(data)
    return caught.value.cause


@pytest.mark.parametrize(("message", "data"), CONTROL.values(), ids=CONTROL)
def test_each_kind_has_these_very_bytes(message: Control, data: bytes) -> None:
    assert encode_control(message) == data
    decoded = decode_control(data)
    assert type(decoded) is type(message)
    # By the bytes, as NaN is not equal to itself.
    assert encode_control(decoded) == data


@pytest.mark.parametrize(
    "message",
    [
        Hello(""),
        Hello("žilice " * 10),
        Bye(2**63 - 1, 0),
        ClockReply(0, -(2**62), 2**62 - 1, 0),
        DisplayReport(0, "me", 1, 2, 3, 0.1, 0.2, 0.3, 0.4),
        Welcome(
            1,
            2,
            StreamDescription(
                name="x" * 80,
                period_ns=10_000_000_000,
                batch=4096,
                channels=tuple(Channel(f"{i}" * 40) for i in range(64)),
                layer=ElasticLayer(1e5, 1e-3, 0.0, 0.02),
                bytes_per_sample=8,
            ),
        ),
    ],
    ids=lambda message: type(message).__name__,
)
def test_what_is_encoded_is_what_is_decoded(message: Control) -> None:
    assert decode_control(encode_control(message)) == message


@pytest.mark.parametrize("data", [data for _, data in CONTROL.values()], ids=CONTROL)
def test_a_message_cut_short_anywhere_is_truncated(data: bytes) -> None:
    assert {cause_of(data[:length]) for length in range(len(data))} == {"truncated"}


@pytest.mark.parametrize("kind", ["", "Hello", "frame", "x" * 60_000, None, 1, True, b"hello", []])
def test_an_unknown_kind_is_malformed(kind: object) -> None:
    assert cause_of(msgpack.packb([1, kind, "me"])) == "malformed"


@pytest.mark.parametrize("message", [[1], [], {"kind": "hello"}, "hello", None], ids=repr)
def test_what_is_no_array_with_a_kind_is_malformed(message: object) -> None:
    assert cause_of(msgpack.packb(message)) == "malformed"


@pytest.mark.parametrize("data", [data for _, data in CONTROL.values()], ids=CONTROL)
def test_a_field_too_few_or_too_many_is_malformed(data: bytes) -> None:
    fields = msgpack.unpackb(data)
    assert cause_of(msgpack.packb(fields[:-1])) == "malformed"
    assert cause_of(msgpack.packb([*fields, fields[-1]])) == "malformed"


@pytest.mark.parametrize("version", [0, 2, True, 1.0, "1", None])
@pytest.mark.parametrize("data", [data for _, data in CONTROL.values()], ids=CONTROL)
def test_another_version_is_refused_as_such(data: bytes, version: object) -> None:
    assert cause_of(msgpack.packb([version, *msgpack.unpackb(data)[1:]])) == "version"


def replaced(fields: list[object], position: int, value: object) -> bytes:
    return msgpack.packb(  # type: ignore[no-any-return]
        [*fields[:position], value, *fields[position + 1 :]]
    )


@pytest.mark.parametrize("value", [True, False, 7.0, "7", None, b"\x07", [7], -1, 2**63])
@pytest.mark.parametrize(
    ("fields", "position"),
    [
        ([1, "bye", 7, 5000], 2),
        ([1, "bye", 7, 5000], 3),
        (WELCOME, 2),
        (WELCOME, 3),
        (CLOCK, 2),
        (REPORT, 2),
        (REPORT, 4),
        (REPORT, 5),
        (REPORT, 6),
    ],
)
def test_sessions_and_counts_are_ints_from_0(
    fields: list[object], position: int, value: object
) -> None:
    assert cause_of(replaced(fields, position, value)) == "malformed"


@pytest.mark.parametrize("value", [True, 1.0, "1", None, 2**63, 2**64 - 1])
@pytest.mark.parametrize(
    ("fields", "position"), [([1, "clock?", 5], 2), (CLOCK, 3), (CLOCK, 4), (CLOCK, 5)]
)
def test_times_are_ints_of_63_bits_and_a_sign(
    fields: list[object], position: int, value: object
) -> None:
    assert cause_of(replaced(fields, position, value)) == "malformed"


@pytest.mark.parametrize("value", [True, "1.5", None, [1.5]])
@pytest.mark.parametrize("position", [7, 8, 9, 10])
def test_a_reports_measures_are_numbers(position: int, value: object) -> None:
    assert cause_of(replaced([*REPORT], position, value)) == "malformed"


def test_a_whole_number_serves_as_a_measure() -> None:
    report = decode_control(replaced([*REPORT], 9, 40))
    assert report == DisplayReport(7, "me", 90, 6, 4, 1.5, 2.5, 40, 0.25)


@pytest.mark.parametrize("fields", [[1, "hello", "me"], REPORT], ids=["hello", "report"])
@pytest.mark.parametrize(
    "name", ["x" * 81, "x" * 60_000, "a\nb", "\x1b[2J", "\x00", b"me", 7, None, ["me"]]
)
def test_a_display_has_a_short_name_that_a_terminal_can_show(
    name: object, fields: list[object]
) -> None:
    assert cause_of(replaced(fields, fields.index("me"), name)) == "malformed"


@pytest.mark.parametrize("description", [{}, {"name": "x"}, {"a": 1}])
def test_a_welcome_with_an_invalid_description_is_told_apart(description: object) -> None:
    assert cause_of(replaced([*WELCOME], 4, description)) == "description"


@pytest.mark.parametrize("description", [None, "pulse", 5, [1, 2], True], ids=repr)
def test_a_welcome_without_a_table_for_its_description_is_malformed(description: object) -> None:
    assert cause_of(replaced([*WELCOME], 4, description)) == "malformed"


def test_an_oversized_message_is_refused_as_such() -> None:
    assert cause_of(bytes(MAX_CONTROL_BYTES + 1)) == "oversized"
