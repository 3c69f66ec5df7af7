"""Frames of the display board, as `firmware/PROTOCOL.md` states them."""

import pytest

from pulse_drives.stepdir.frames import (
    MOST_BYTES,
    BoardCommand,
    BoardGreeting,
    BoardLimits,
    BoardMode,
    BoardReport,
    BoardState,
    CommandAnswer,
    CommandResult,
    Format,
    HomeSearch,
    StateFlag,
    TripCause,
    board_reader,
    decode_command,
    decode_report,
    encode_command,
    encode_report,
)

FLAGS = StateFlag.HOMED | StateFlag.ON
STATE = BoardState(7, 7_000, 8184, -320, -25_600, BoardMode.RUNNING, TripCause.NONE, FLAGS, 258, 3)
GREETING = BoardGreeting(9, 1, 256, 32_000, 16_368, 2, "ATmega328P")
ANSWER = CommandAnswer(10, Format.LIMITS, CommandResult.OUT_OF_BOUNDS, 4)
LIMITS = BoardLimits(0, 8_000, 32_000_000, 32_000, 1434, 14_934, 4_700, 32_000, 50, 5)


def body_of(frame: bytes) -> bytes:
    (body,) = board_reader().feed(frame)
    return body


def test_a_state_and_a_command_have_the_bytes_of_the_protocol() -> None:
    # format, counter, time, film, position, velocity, state, cause, flags, sequence, rejected
    assert body_of(encode_report(STATE)).hex() == (
        "0107000000581b0000f81fc0feffff009cffff04008100020103"
    )
    frame = encode_command(Format.VELOCITY, 0x0102, (-25_600, 25))
    assert body_of(frame).hex() == "090201009cffff1900"
    # COBS: no zero byte but the last.
    assert frame.count(0) == 1
    assert len(frame) == 13
    # CRC-16/CCITT-FALSE of 0c 01 00.
    assert encode_command(Format.ARM, 1).hex() == "030c0103cc8a00"


@pytest.mark.parametrize("report", [STATE, GREETING, ANSWER], ids=["state", "greeting", "answer"])
def test_a_report_is_decoded_as_it_was_encoded(report: BoardReport) -> None:
    assert decode_report(body_of(encode_report(report))) == report


@pytest.mark.parametrize(
    ("command", "fields"),
    [
        (Format.GREET, ()),
        (Format.VELOCITY, (-1, 1000)),
        (Format.HOME, HomeSearch(8_000, 9_000, 480, 13_000)),
        (Format.LIMITS, LIMITS),
    ],
)
def test_a_command_is_decoded_as_it_was_encoded(command: Format, fields: tuple[int, ...]) -> None:
    body = body_of(encode_command(command, 65_535, fields))
    assert decode_command(body) == BoardCommand(command, 65_535, tuple(fields))


@pytest.mark.parametrize(
    "body",
    [
        b"\x01" + bytes(24), b"\x01" + bytes(26), b"\x02\0\0", b"\x03" + bytes(3),
        b"\x04" + bytes(9), b"\x08\0\0", bytes(26),
        # No such state, cause or result.
        b"\x01" + bytes(18) + b"\x09" + bytes(6), b"\x01" + bytes(19) + b"\x63" + bytes(5),
        b"\x03\0\0\x0c\x40\0",
    ],
)  # fmt: skip
def test_a_body_that_no_board_sends_is_none(body: bytes) -> None:
    assert decode_report(body) is None


@pytest.mark.parametrize(
    "body", [b"", b"\x09", b"\x09\0\0\0\0\0\0", b"\x0c\0\0\0", b"\x01\0\0", b"\x10\0\0"]
)
def test_a_body_that_no_host_sends_is_none(body: bytes) -> None:
    assert decode_command(body) is None


def test_a_greeting_of_a_later_protocol_tells_its_version() -> None:
    later = encode_report(GREETING._replace(protocol=7, name="x" * 24))
    decoded = decode_report(body_of(later))
    assert isinstance(decoded, BoardGreeting)
    assert decoded.protocol == 7


def test_frames_come_whole_from_a_line_of_both_boards() -> None:
    reader = board_reader()
    too_long = b"\x55" * (2 * MOST_BYTES)
    frames = [encode_report(STATE), too_long, b"\0", encode_report(ANSWER)]
    assert list(map(decode_report, reader.feed(b"\0" + b"".join(frames)))) == [STATE, ANSWER]
    assert reader.altered == 1
