"""Frames and control messages: their bytes, round trips, and refusals of whatever a peer sends."""

import itertools
import math
import tracemalloc
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from protocol.errors import WireError
from protocol.wire import messages as wire
from tests.support.message_examples import (
    CONTROL,
    DESCRIPTION,
    FALSE_LENGTHS,
    FLOAT32_BYTES,
    FLOAT32_FRAME,
    FLOAT64_BYTES,
    FLOAT64_FRAME,
    HUGE,
)

Decoder = Callable[[bytes], wire.Frame | wire.ControlMessage]
VALID: dict[str, tuple[Decoder, bytes]] = {
    "float32": (wire.decode_frame, FLOAT32_BYTES),
    "float64": (wire.decode_frame, FLOAT64_BYTES),
    **{name: (wire.decode_control, data) for name, (_, data) in CONTROL.items()},
}
each_message = pytest.mark.parametrize(("decode", "data"), VALID.values(), ids=VALID)
each_decoder = pytest.mark.parametrize("decode", [wire.decode_frame, wire.decode_control])
DTYPES: list[np.dtype[Any]] = [np.dtype("<f4"), np.dtype("<f8")]
REPORT = [2, "report", 7, "me", 90, 5, 6, 4, 1.5, 2.5, 40.0, 0.25]
CLOCK = [2, "clock", 7, 1, 2, 3]
BYE = [2, "bye", 7, 5000]
WELCOME = [2, "welcome", 7, 0, DESCRIPTION.to_wire()]


def cause_of(decode: Decoder, data: bytes) -> str:
    with pytest.raises(WireError) as caught:
        decode(data)
    assert "\n" not in str(caught.value)
    return caught.value.cause


def packed(value: object) -> bytes:
    return msgpack.packb(value)


def changed(**fields: object) -> bytes:
    """Return the float32 frame with other fields."""
    names = ("version", "session", "first", "t_first", "period", "channels", "width", "payload")
    table: dict[str, object] = dict(zip(names, msgpack.unpackb(FLOAT32_BYTES), strict=True))
    return packed(list((table | fields).values()))


def replaced(fields: list[Any], position: int, value: object) -> bytes:
    return packed([*fields[:position], value, *fields[position + 1 :]])


def assert_same(one: wire.Frame, other: wire.Frame) -> None:
    assert one[:4] == other[:4]
    assert one.values.dtype == other.values.dtype
    np.testing.assert_array_equal(one.values, other.values)


@pytest.mark.parametrize(
    ("frame", "data"), [(FLOAT32_FRAME, FLOAT32_BYTES), (FLOAT64_FRAME, FLOAT64_BYTES)]
)
def test_a_frame_has_these_bytes(frame: wire.Frame, data: bytes) -> None:
    assert wire.encode_frame(frame) == data
    assert_same(wire.decode_frame(data), frame)


@pytest.mark.parametrize(("message", "data"), CONTROL.values(), ids=CONTROL)
def test_a_control_message_has_these_bytes(message: wire.ControlMessage, data: bytes) -> None:
    assert wire.encode_control(message) == data
    decoded = wire.decode_control(data)
    assert type(decoded) is type(message)
    # By the bytes, as NaN is not equal to itself.
    assert wire.encode_control(decoded) == data


@given(
    st.builds(
        wire.Frame,
        session=st.integers(0, 2**63 - 1),
        first_sample=st.integers(0, 2**53 - 1),
        t_first_ns=st.integers(-(2**62), 2**62 - 1),
        period_ns=st.integers(1, 10_000_000_000),
        values=hnp.arrays(
            st.sampled_from(DTYPES),
            st.tuples(st.integers(1, 40), st.integers(1, 64)),
            elements=st.floats(-1e6, 1e6, width=32),
        ),
    )
)
def test_a_frame_is_decoded_as_it_was_encoded(frame: wire.Frame) -> None:
    assert_same(wire.decode_frame(wire.encode_frame(frame)), frame)


@pytest.mark.parametrize(
    "values",
    [
        np.arange(6, dtype=">f4").reshape(3, 2),
        np.asfortranarray(np.arange(6, dtype="<f4").reshape(3, 2)),
        np.arange(12, dtype="<f4").reshape(6, 2)[::2],
    ],
    ids=["big-endian", "column by column", "every second sample"],
)
def test_samples_are_encoded_in_order_from_any_memory_layout(values: NDArray[Any]) -> None:
    decoded = wire.decode_frame(wire.encode_frame(FLOAT32_FRAME._replace(values=values))).values
    assert decoded.dtype == np.dtype("<f4")
    np.testing.assert_array_equal(decoded, values)


def test_the_largest_frame_is_accepted_and_one_byte_more_is_refused() -> None:
    # These numbers are 1, 2 and 3 bytes long: they fill what whole samples leave.
    sizes = {
        len(data): data
        for session in (0, 128, 256)
        for first in (0, 128, 256)
        for samples in range(16_370, 16_390)
        if (data := changed(payload=bytes(4 * samples), session=session, first=first))
    }
    assert len(wire.decode_frame(sizes[wire.MAX_FRAME_BYTES]).values) > 16_370
    assert cause_of(wire.decode_frame, sizes[wire.MAX_FRAME_BYTES + 1]) == "oversized"


@each_decoder
def test_an_oversized_message_is_refused_before_it_is_read(decode: Decoder) -> None:
    assert cause_of(decode, b"\xc1" * (wire.MAX_FRAME_BYTES + 1)) == "oversized"


@each_message
def test_a_message_cut_short_anywhere_is_truncated(decode: Decoder, data: bytes) -> None:
    assert {cause_of(decode, data[:length]) for length in range(len(data))} == {"truncated"}
    assert cause_of(decode, data + b"\x00") == "not_msgpack"


@each_message
def test_another_version_is_refused_as_such(decode: Decoder, data: bytes) -> None:
    fields = msgpack.unpackb(data)[1:]
    for version in (0, 1, 3, -1, 2**64 - 1, True, 1.0, "1", None, [1], b"\x01"):
        assert cause_of(decode, packed([version, *fields])) == "version"
    # Also where the other fields have changed.
    assert cause_of(decode, packed([3, "a format", "of the future"])) == "version"


@each_message
def test_a_field_too_few_or_too_many_is_malformed(decode: Decoder, data: bytes) -> None:
    fields = msgpack.unpackb(data)
    for wrong in (fields[:-1], [*fields, fields[-1]], fields[:1], [], fields * 3):
        assert cause_of(decode, packed(wrong)) == "malformed"


@each_decoder
@pytest.mark.parametrize("message", [{"version": 1}, "frame", 1, None, True, b"\x01"], ids=repr)
def test_a_message_that_is_no_array_is_malformed(message: object, decode: Decoder) -> None:
    assert cause_of(decode, packed(message)) == "malformed"


NOT_INTS = [True, False, 1.0, "1", None, b"\x01", [1], {"a": 1}]


@pytest.mark.parametrize(
    ("field", "values"),
    [
        ("session", [*NOT_INTS, -1, 2**63]),
        ("first", [*NOT_INTS, -1, 2**53]),
        ("t_first", [*NOT_INTS, 2**62, 2**64 - 1]),
        ("period", [*NOT_INTS, 0, -1_000_000, 10_000_000_001]),
        ("channels", [*NOT_INTS, 0, -1, 65, 2**63]),
        ("width", [*NOT_INTS, 0, 2, -4, 16]),
        ("payload", [1, None, "text", [0.5], True, 0.5, b""]),
    ],
)
def test_a_frame_field_of_wrong_type_or_range_is_malformed(
    field: str, values: list[object]
) -> None:
    for value in values:
        # Whole samples for any of these channels and widths, so that nothing else is wrong.
        data = changed(**{"payload": bytes(16 * 65), field: value})
        assert cause_of(wire.decode_frame, data) == "malformed", value


@pytest.mark.parametrize(
    ("size", "channels", "width"),
    [(1, 1, 4), (7, 1, 4), (9, 1, 4), (4, 1, 8), (12, 2, 4), (8, 3, 4), (8, 64, 4)],
)
def test_a_payload_of_a_broken_sample_is_malformed(size: int, channels: int, width: int) -> None:
    data = changed(payload=bytes(size), channels=channels, width=width)
    assert cause_of(wire.decode_frame, data) == "malformed"


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_frame_with_one_sample_that_is_not_finite_is_refused(dtype: np.dtype[Any]) -> None:
    for value, place in itertools.product((np.nan, np.inf, -np.inf), (0, 1, 2)):
        values = np.zeros((3, 3), dtype)
        values[place, place] = value
        data = wire.encode_frame(FLOAT32_FRAME._replace(values=values))
        assert cause_of(wire.decode_frame, data) == "not_finite", (value, place)


@pytest.mark.parametrize("dtype", DTYPES)
def test_samples_at_the_largest_force_are_taken_and_beyond_refused(dtype: np.dtype[Any]) -> None:
    values = np.array([[wire.LARGEST_N, -wire.LARGEST_N]] * 500, dtype)
    data = wire.encode_frame(FLOAT32_FRAME._replace(values=values))
    assert np.array_equal(wire.decode_frame(data).values, values)
    values[-1, -1] *= 1.001
    data = wire.encode_frame(FLOAT32_FRAME._replace(values=values))
    assert cause_of(wire.decode_frame, data) == "not_finite"


@pytest.mark.parametrize("kind", ["", "Hello", "frame", "x" * 60_000, None, 1, True, b"hello", []])
def test_an_unknown_kind_is_malformed(kind: object) -> None:
    assert cause_of(wire.decode_control, packed([2, kind, "me"])) == "malformed"


@pytest.mark.parametrize(
    "force_n", [math.nan, math.inf, -math.inf, -1e-9, -1, 1.001 * wire.LARGEST_N, 2**63]
)
def test_a_set_point_that_no_finger_can_press_is_refused(force_n: float) -> None:
    message = [2, "set_point", 7, 11, 3, 0, 1, force_n]
    assert cause_of(wire.decode_control, packed(message)) == "not_finite"
    wire.decode_control(packed([*message[:-1], 0]))


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.001 * wire.LARGEST_N])
@pytest.mark.parametrize("position", [-1, -2])
def test_a_probe_report_holds_finite_figures(value: float, position: int) -> None:
    message = [2, "probe", 7, 11, 4, 2, 1, 9, "pressing", 1.5, 0.0]
    message[position] = value
    assert cause_of(wire.decode_control, packed(message)) == "not_finite"


BAD_COUNTS = [True, False, 7.0, "7", None, b"\x07", [7], -1, 2**63]
BAD_TIMES = [True, 1.0, "1", None, 2**63, 2**64 - 1]
BAD_NUMBERS = [True, "1.5", None, [1.5]]
BAD_NAMES = ["x" * 81, "x" * 60_000, "a\nb", "\x1b[2J", "\x00", b"me", 7, None, ["me"]]


@pytest.mark.parametrize(
    ("fields", "positions", "values"),
    [
        (BYE, [2, 3], BAD_COUNTS), (WELCOME, [2, 3], BAD_COUNTS), (CLOCK, [2], BAD_COUNTS),
        (REPORT, [2, 4, 5, 6, 7], BAD_COUNTS), ([2, "clock?", 5], [2], BAD_TIMES),
        (CLOCK, [3, 4, 5], BAD_TIMES), (REPORT, [8, 9, 10, 11], BAD_NUMBERS),
        (REPORT, [3], BAD_NAMES), ([2, "hello", "me"], [2], BAD_NAMES),
        (WELCOME, [4], [None, "pulse", 5, [1, 2], True]),
    ],
)  # fmt: skip
def test_a_control_field_of_another_type_or_out_of_range_is_malformed(
    fields: list[object], positions: list[int], values: list[object]
) -> None:
    for position in positions:
        for value in values:
            data = replaced(fields, position, value)
            assert cause_of(wire.decode_control, data) == "malformed", (position, value)


def test_a_report_may_contain_integers_and_nan() -> None:
    report = wire.decode_control(replaced(REPORT, 10, 40))
    assert report == wire.DisplayReport(7, "me", 90, 5, 6, 4, 1.5, 2.5, 40, 0.25)
    unknown = wire.decode_control(replaced(REPORT, 10, math.nan))
    assert isinstance(unknown, wire.DisplayReport)
    assert math.isnan(unknown.playout_delay_ms)


@pytest.mark.parametrize("description", [{}, {"name": "x"}, {"a": 1}])
def test_an_invalid_description_has_a_cause_of_its_own(description: object) -> None:
    assert cause_of(wire.decode_control, replaced(WELCOME, 4, description)) == "description"


ODD = FALSE_LENGTHS | {
    "a huge array in a field": b"\x98\x02\xdd" + HUGE,
    "a huge array in a description": b"\x95\x02\xa7welcome\x07\x00\x81\xa1a\xdd" + HUGE,
    "nesting just within msgpack's stack": b"\x91" * 1000 + b"\x90",
    "nesting where the kind is": b"\x92\x02" + b"\x91" * 1000 + b"\x90",
    "nesting where the description is": b"\x95\x02\xa7welcome\x07\x00\x81\xa4name"
    + b"\x91" * 1000
    + b"\x90",
    "a nested map": b"\x92\x02" + b"\x81\xa1a" * 1000 + b"\x90",
    "an extension": msgpack.packb([wire.VERSION, msgpack.ExtType(5, b"x")]),
    "an extension for a name": msgpack.packb([wire.VERSION, "hello", msgpack.ExtType(5, b"x")]),
    "a timestamp": msgpack.packb([wire.VERSION, msgpack.Timestamp(1, 2)]),
    "a timestamp for the version": b"\x92\xd6\xff" + HUGE + b"\x01",
    "a timestamp of too many ns": b"\x92\x02\xc7\x0c\xff" + b"\xff" * 12,
    "a timestamp of the wrong length": b"\x92\x02\xc7\x03\xff" + b"\xff" * 3,
    "a text that is no UTF-8": b"\x93\x02\xa5hello\xa2\xff\xfe",
    "a surrogate in a text": b"\x93\x02\xa5hello\xa3\xed\xa0\x80",
    "a list for a key": b"\x93\x02\x81\x91\x01\x01\x01",
    "a number for a key": b"\x95\x02\xa7welcome\x07\x00\x81\x01\x01",
    "bytes for a key": b"\x95\x02\xa7welcome\x07\x00\x81\xc4\x02\xff\xfe\x01",
    "a key of 60 kB": msgpack.packb([wire.VERSION, "welcome", 7, 0, {"k" * 60_000: 1}]),
    "60 kB where the version is": msgpack.packb(["v" * 60_000]),
    "the byte that msgpack never uses": b"\xc1",
}


@each_decoder
@pytest.mark.parametrize("data", ODD.values(), ids=ODD)
def test_refusing_a_hostile_message_costs_only_its_size(data: bytes, decode: Decoder) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(WireError):
            decode(data)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1_000_000
