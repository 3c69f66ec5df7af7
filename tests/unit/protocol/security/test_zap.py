import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.security import zap

KEY = bytes(range(32))
REQUEST = [b"1.0", b"17", b"telepulse", b"192.0.2.7", b"", b"CURVE", KEY]


def test_a_request_has_the_address_and_the_key() -> None:
    assert zap.decode_request(REQUEST) == zap.ZapRequest("192.0.2.7", KEY)


@pytest.mark.parametrize(
    ("part", "value"),
    [(0, b"2.0"), (2, b"other"), (5, b"NULL"), (5, b"PLAIN"), (6, KEY[:-1]), (6, KEY + b"\0")],
)
def test_a_request_of_another_kind_is_refused(part: int, value: bytes) -> None:
    assert zap.decode_request([*REQUEST[:part], value, *REQUEST[part + 1 :]]) is None


@given(st.lists(st.binary(max_size=40), max_size=9))
def test_any_frames_are_a_request_or_none_and_get_a_reply(frames: list[bytes]) -> None:
    peer = zap.decode_request(frames)
    assert peer is None or (len(frames) == 7 and peer.key == frames[6])
    assert len(zap.encode_reply(frames, "unknown_key")) == 6


@pytest.mark.parametrize(
    ("cause", "status"),
    [(None, b"200"), ("unknown_key", b"400"), ("revoked_key", b"400"), ("list_unreadable", b"500")],
)
def test_a_reply_is_to_its_request_and_separates_a_refusal_from_no_verdict(
    cause: str | None, status: bytes
) -> None:
    assert zap.encode_reply(REQUEST, cause)[:3] == [b"1.0", b"17", status]
    assert zap.encode_reply([], cause)[1] == b""
