import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.security import zap
from protocol.security.zap import ZapRequest, read_request, reply

KEY = bytes(range(32))
REQUEST = [b"1.0", b"17", b"telepulse", b"192.0.2.7", b"", b"CURVE", KEY]


def test_a_request_says_whence_and_with_which_key() -> None:
    assert read_request(REQUEST) == ZapRequest("192.0.2.7", KEY)


@pytest.mark.parametrize(
    ("part", "value"),
    [(0, b"2.0"), (2, b"other"), (5, b"NULL"), (5, b"PLAIN"), (6, KEY[:-1]), (6, KEY + b"\0")],
)
def test_what_is_no_request_for_us_lets_nobody_in(part: int, value: bytes) -> None:
    assert read_request([*REQUEST[:part], value, *REQUEST[part + 1 :]]) is None


@given(st.lists(st.binary(max_size=40), max_size=9))
def test_any_frames_are_a_request_or_none_and_get_a_reply(frames: list[bytes]) -> None:
    knock = read_request(frames)
    assert knock is None or (len(frames) == 7 and knock.key == frames[6])
    assert len(reply(frames, None)) == 6


def test_a_reply_is_to_its_request() -> None:
    assert reply(REQUEST, "finger") == [b"1.0", b"17", b"200", b"", b"finger", b""]
    assert reply(REQUEST, None)[:3] == [b"1.0", b"17", b"400"]
    assert reply([], None)[1] == b""
    assert zap.ENDPOINT == "inproc://zeromq.zap.01"
