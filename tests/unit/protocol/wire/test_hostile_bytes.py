"""Whatever bytes a peer sends: a valid message or a WireError, and little memory."""

import tracemalloc
from collections.abc import Callable
from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from protocol.errors import WireError
from protocol.wire.messages import (
    MAX_CONTROL_BYTES,
    MAX_FRAME_BYTES,
    VERSION,
    Control,
    Frame,
    decode_control,
    decode_frame,
    encode_control,
)
from tests.support.message_examples import CONTROL, FLOAT32_BYTES, FLOAT64_BYTES

Decoder = Callable[[bytes], Frame | Control]
DECODERS: list[Decoder] = [decode_frame, decode_control]
CAUSES = (
    None,
    "truncated",
    "not_msgpack",
    "malformed",
    "version",
    "description",
    "oversized",
    "not_finite",
)
KINDS = ("hello", "welcome", "bye", "clock?", "clock", "report")
VALID = [FLOAT32_BYTES, FLOAT64_BYTES, *(data for _, data in CONTROL.values())]

plain = st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text()
values = st.recursive(
    plain | st.binary(),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(), inner, max_size=5),
    max_leaves=20,
)


def try_both(data: bytes) -> None:
    for decode in DECODERS:
        try:
            message = decode(data)
        except WireError as error:
            cause: str | None = error.cause
        else:
            cause = None
            assert_valid(message)
        assert cause in CAUSES


def assert_valid(message: Frame | Control) -> None:
    if not isinstance(message, Frame):
        encode_control(message)
        return
    assert message.session >= 0
    assert message.first_sample >= 0
    assert message.period_ns > 0
    assert message.values.size > 0
    assert np.isfinite(message.values).all()


@given(st.binary(max_size=300))
@example(b"")
@example(b"\xc1")
@example(b"\x91\x01")
def test_any_bytes(data: bytes) -> None:
    try_both(data)


@given(values)
def test_any_msgpack(value: object) -> None:
    try_both(msgpack.packb(value))


@given(st.lists(values, max_size=12))
def test_any_fields_behind_the_right_version(fields: list[object]) -> None:
    try_both(msgpack.packb([VERSION, *fields]))


@given(st.sampled_from(KINDS), st.lists(values, max_size=10))
def test_any_fields_behind_a_known_kind(kind: str, fields: list[object]) -> None:
    try_both(msgpack.packb([VERSION, kind, *fields]))


@given(st.dictionaries(st.text() | st.sampled_from(["name", "batch", "layer"]), values))
def test_any_description(description: dict[str, Any]) -> None:
    try_both(msgpack.packb([VERSION, "welcome", 7, 0, description]))


@given(st.sampled_from(VALID), st.data())
def test_a_valid_message_with_one_byte_changed(valid: bytes, data: st.DataObject) -> None:
    position = data.draw(st.integers(0, len(valid) - 1))
    byte = data.draw(st.integers(0, 255))
    try_both(valid[:position] + bytes([byte]) + valid[position + 1 :])


HUGE = b"\xff\xff\xff\xff"
ODD = {
    "an array of 2^32 - 1, empty": b"\xdd" + HUGE,
    "a map of 2^32 - 1, empty": b"\xdf" + HUGE,
    "bytes of 2^32 - 1, empty": b"\xc6" + HUGE,
    "a text of 2^32 - 1, empty": b"\xdb" + HUGE,
    "an extension of 2^32 - 1, empty": b"\xc9" + HUGE + b"\x05",
    "a huge array in a field": b"\x98\x01\xdd" + HUGE,
    "a huge array in a description": b"\x95\x01\xa7welcome\x07\x00\x81\xa1a\xdd" + HUGE,
    "an array as long as the message": b"\xdc\xff\xf0" + bytes(MAX_FRAME_BYTES - 100),
    "nested arrays without content": (b"\xdc\xff\xf0" * 1000).ljust(MAX_FRAME_BYTES, b"\x00"),
    "nested maps without content": (b"\xde\xff\xf0\xa0" * 1000).ljust(MAX_FRAME_BYTES, b"\x00"),
    "nesting beyond msgpack's stack": b"\x91" * (MAX_FRAME_BYTES - 1) + b"\x90",
    "nesting just within msgpack's stack": b"\x91" * 1000 + b"\x90",
    "nesting where the kind is": b"\x92\x01" + b"\x91" * 1000 + b"\x90",
    "nesting where the description is": b"\x95\x01\xa7welcome\x07\x00\x81\xa4name"
    + b"\x91" * 1000
    + b"\x90",
    "a nested map": b"\x92\x01" + b"\x81\xa1a" * 1000 + b"\x90",
    "an extension": msgpack.packb([VERSION, msgpack.ExtType(5, b"x")]),
    "an extension for a name": msgpack.packb([VERSION, "hello", msgpack.ExtType(5, b"x")]),
    "a timestamp": msgpack.packb([VERSION, msgpack.Timestamp(1, 2)]),
    "a timestamp for the version": b"\x92\xd6\xff" + HUGE + b"\x01",
    "a timestamp of too many ns": b"\x92\x01\xc7\x0c\xff" + b"\xff" * 12,
    "a timestamp of the wrong length": b"\x92\x01\xc7\x03\xff" + b"\xff" * 3,
    "a text that is no UTF-8": b"\x93\x01\xa5hello\xa2\xff\xfe",
    "a surrogate in a text": b"\x93\x01\xa5hello\xa3\xed\xa0\x80",
    "a list for a key": b"\x93\x01\x81\x91\x01\x01\x01",
    "a number for a key": b"\x95\x01\xa7welcome\x07\x00\x81\x01\x01",
    "bytes for a key": b"\x95\x01\xa7welcome\x07\x00\x81\xc4\x02\xff\xfe\x01",
    "a key of 60 kB": msgpack.packb([VERSION, "welcome", 7, 0, {"k" * 60_000: 1}]),
    "60 kB where the version is": msgpack.packb(["v" * 60_000]),
    "the byte that msgpack never uses": b"\xc1",
}


@pytest.mark.parametrize("decode", DECODERS)
@pytest.mark.parametrize("data", ODD.values(), ids=ODD)
def test_an_odd_message_is_refused_at_the_cost_of_its_own_size(
    data: bytes, decode: Decoder
) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(WireError):
            decode(data)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 1_000_000


@pytest.mark.parametrize(
    ("decode", "limit"), [(decode_frame, MAX_FRAME_BYTES), (decode_control, MAX_CONTROL_BYTES)]
)
def test_what_is_oversized_is_not_even_looked_at(decode: Decoder, limit: int) -> None:
    with pytest.raises(WireError) as caught:
        decode(b"\xc1" * (limit + 1))
    assert caught.value.cause == "oversized"
