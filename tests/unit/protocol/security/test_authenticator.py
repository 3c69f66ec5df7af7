import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.security.authenticator import (
    ZAP_ENDPOINT,
    ZapRequest,
    decode_zap_request,
    encode_zap_reply,
)

KEY = bytes(range(32))
REQUEST = [b"1.0", b"17", b"telepulse", b"192.0.2.7", b"", b"CURVE", KEY]


def test_a_request_has_the_address_and_the_key() -> None:
    assert decode_zap_request(REQUEST) == ZapRequest("192.0.2.7", KEY)


@pytest.mark.parametrize(
    ("part", "value"),
    [(0, b"2.0"), (2, b"other"), (5, b"NULL"), (5, b"PLAIN"), (6, KEY[:-1]), (6, KEY + b"\0")],
)
def test_a_request_of_another_kind_is_refused(part: int, value: bytes) -> None:
    assert decode_zap_request([*REQUEST[:part], value, *REQUEST[part + 1 :]]) is None


@given(st.lists(st.binary(max_size=40), max_size=9))
def test_any_frames_are_a_request_or_none_and_get_a_reply(frames: list[bytes]) -> None:
    peer = decode_zap_request(frames)
    assert peer is None or (len(frames) == 7 and peer.key == frames[6])
    assert len(encode_zap_reply(frames, None)) == 6


def test_a_reply_is_to_its_request() -> None:
    assert encode_zap_reply(REQUEST, "finger") == [b"1.0", b"17", b"200", b"", b"finger", b""]
    assert encode_zap_reply(REQUEST, None)[:3] == [b"1.0", b"17", b"400"]
    assert encode_zap_reply([], None)[1] == b""
    assert ZAP_ENDPOINT == "inproc://zeromq.zap.01"
