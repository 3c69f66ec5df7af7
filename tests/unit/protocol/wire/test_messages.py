"""Data frames on the wire."""

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from protocol.errors import WireError
from protocol.wire.messages import MAX_FRAME_BYTES, Frame, decode_frame, encode_frame
from tests.support.message_examples import (
    FLOAT32_BYTES,
    FLOAT32_FRAME,
    FLOAT64_BYTES,
    FLOAT64_FRAME,
)

FIELDS = ("version", "session", "first", "t_first", "period", "channels", "width", "payload")
INT63 = 2**63
DTYPES: list[np.dtype[Any]] = [np.dtype("<f4"), np.dtype("<f8")]


def changed(**fields: object) -> bytes:
    """The float32 frame with other fields."""
    table: dict[str, object] = dict(zip(FIELDS, msgpack.unpackb(FLOAT32_BYTES), strict=True))
    return msgpack.packb(list((table | fields).values()))  # type: ignore[no-any-return]


def cause_of(data: bytes) -> str:
    with pytest.raises(WireError) as caught:
        decode_frame(data)
    assert "\n" not in str(caught.value)
    return caught.value.cause


def assert_same(one: Frame, other: Frame) -> None:
    assert one[:4] == other[:4]
    assert one.values.dtype == other.values.dtype
    np.testing.assert_array_equal(one.values, other.values)


@pytest.mark.parametrize(
    ("frame", "data"),
    [(FLOAT32_FRAME, FLOAT32_BYTES), (FLOAT64_FRAME, FLOAT64_BYTES)],
    ids=["float32", "float64"],
)
def test_a_frame_has_these_very_bytes(frame: Frame, data: bytes) -> None:
    assert encode_frame(frame) == data
    assert_same(decode_frame(data), frame)


@given(
    session=st.integers(0, INT63 - 1),
    first_sample=st.integers(0, 2**53 - 1),
    t_first_ns=st.integers(-(2**62), 2**62 - 1),
    period_ns=st.integers(1, 10_000_000_000),
    values=hnp.arrays(
        st.sampled_from(DTYPES),
        st.tuples(st.integers(1, 40), st.integers(1, 64)),
        elements=st.floats(-1e6, 1e6, width=32),
    ),
)
def test_what_is_encoded_is_what_is_decoded(
    session: int, first_sample: int, t_first_ns: int, period_ns: int, values: NDArray[Any]
) -> None:
    frame = Frame(session, first_sample, t_first_ns, period_ns, values)
    assert_same(decode_frame(encode_frame(frame)), frame)


@pytest.mark.parametrize(
    "values",
    [
        np.arange(6, dtype=">f4").reshape(3, 2),
        np.asfortranarray(np.arange(6, dtype="<f4").reshape(3, 2)),
        np.arange(12, dtype="<f4").reshape(6, 2)[::2],
    ],
    ids=["big-endian", "column by column", "every second sample"],
)
def test_samples_travel_one_after_the_other_however_they_lie_in_memory(
    values: NDArray[Any],
) -> None:
    decoded = decode_frame(encode_frame(FLOAT32_FRAME._replace(values=values))).values
    assert decoded.dtype == np.dtype("<f4")
    np.testing.assert_array_equal(decoded, values)


def test_a_frame_as_large_as_allowed_is_taken_and_one_byte_more_is_not() -> None:
    # These numbers are 1, 2 and 3 bytes long: they fill what whole samples leave.
    sizes = {
        len(data): data
        for session in (0, 128, 256)
        for first in (0, 128, 256)
        for samples in range(16_370, 16_390)
        if (data := changed(payload=bytes(4 * samples), session=session, first=first))
    }
    assert len(decode_frame(sizes[MAX_FRAME_BYTES]).values) > 16_370
    assert cause_of(sizes[MAX_FRAME_BYTES + 1]) == "oversized"


@pytest.mark.parametrize("data", [FLOAT32_BYTES, FLOAT64_BYTES], ids=["float32", "float64"])
def test_a_frame_cut_short_anywhere_is_truncated(data: bytes) -> None:
    assert {cause_of(data[:length]) for length in range(len(data))} == {"truncated"}


def test_bytes_behind_a_frame_are_refused() -> None:
    assert cause_of(FLOAT32_BYTES + b"\x00") == "not_msgpack"


@pytest.mark.parametrize("version", [0, 2, -1, 2**64 - 1, True, 1.0, "1", None, [1], b"\x01"])
def test_another_version_is_refused_as_such(version: object) -> None:
    assert cause_of(changed(version=version)) == "version"


def test_the_version_is_told_even_where_the_other_fields_have_changed_too() -> None:
    assert cause_of(msgpack.packb([2, "a format", "of the future"])) == "version"


NOT_INTS = [True, False, 1.0, "1", None, b"\x01", [1], {"a": 1}]


@pytest.mark.parametrize("value", NOT_INTS, ids=repr)
@pytest.mark.parametrize("field", ["session", "first", "t_first", "period", "channels", "width"])
def test_what_is_no_int_is_malformed(field: str, value: object) -> None:
    assert cause_of(changed(**{field: value})) == "malformed"


@pytest.mark.parametrize("payload", [1, None, "text", [0.5], True, 0.5], ids=repr)
def test_a_payload_that_is_no_bytes_is_malformed(payload: object) -> None:
    assert cause_of(changed(payload=payload)) == "malformed"


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("session", -1),
        ("session", INT63),
        ("first", -1),
        ("first", 2**53),
        ("t_first", 2**62),
        ("t_first", 2**64 - 1),
        ("period", 0),
        ("period", -1_000_000),
        ("period", 10_000_000_001),
        ("channels", 0),
        ("channels", -1),
        ("channels", 65),
        ("channels", 2**63),
        ("width", 0),
        ("width", 2),
        ("width", -4),
        ("width", 16),
    ],
)
def test_a_field_out_of_its_range_is_malformed(field: str, value: int) -> None:
    # Whole samples for any of these channels and widths, so that nothing else is wrong.
    assert cause_of(changed(**{"payload": bytes(16 * 65), field: value})) == "malformed"


@pytest.mark.parametrize(
    ("size", "channels", "width"),
    [(0, 1, 4), (1, 1, 4), (7, 1, 4), (9, 1, 4), (4, 1, 8), (12, 2, 4), (8, 3, 4), (8, 64, 4)],
)
def test_a_payload_of_no_whole_number_of_samples_is_malformed(
    size: int, channels: int, width: int
) -> None:
    data = changed(payload=bytes(size), channels=channels, width=width)
    assert cause_of(data) == "malformed"


@pytest.mark.parametrize("samples", [np.empty((0, 1), "<f4"), np.empty((0, 64), "<f8")])
def test_a_frame_without_samples_is_malformed(samples: NDArray[Any]) -> None:
    assert cause_of(encode_frame(FLOAT32_FRAME._replace(values=samples))) == "malformed"


@pytest.mark.parametrize("count", [0, 1, 7, 9, 20])
def test_a_frame_has_eight_fields(count: int) -> None:
    fields = (msgpack.unpackb(FLOAT32_BYTES) * 3)[:count]
    assert cause_of(msgpack.packb(fields)) == "malformed"


@pytest.mark.parametrize("message", [{"version": 1}, "frame", 1, None, True, b"\x01"], ids=repr)
def test_what_is_no_array_is_malformed(message: object) -> None:
    assert cause_of(msgpack.packb(message)) == "malformed"


@pytest.mark.parametrize("dtype", ["<f4", "<f8"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [(0, 0), (1, 1), (2, 2)])
def test_one_sample_that_is_no_number_spoils_the_frame(
    place: tuple[int, int], value: float, dtype: str
) -> None:
    values = np.zeros((3, 3), dtype)
    values[place] = value
    assert cause_of(encode_frame(FLOAT32_FRAME._replace(values=values))) == "not_finite"
