import itertools
import struct

import numpy as np
import pytest
from cobs import cobs
from hypothesis import given
from hypothesis import strategies as st

from pulse_sensors.binary_frames import MAX_SAMPLES, FrameDecoder, FrameEncoder, SampleFormat, crc
from pulse_sensors.reading import Packet

MS = 1_000_000
FRAME = 4


def frames(count: int, first_ms: int = 0) -> list[bytes]:
    """Frames of 4 samples, one a ms: sample i has the value i."""
    encoder = FrameEncoder("int16")
    return [
        encoder.frame(range(i, i + FRAME), (first_ms + i + FRAME - 1) * 1_000)
        for i in range(0, count * FRAME, FRAME)
    ]


def decoded(data: bytes) -> tuple[list[Packet], dict[str, int]]:
    decoder = FrameDecoder(MS)
    return decoder.feed(data), dict(decoder.rejected)


def values(packets: list[Packet]) -> list[float]:
    return [value for packet in packets for value in packet.values]


def raw(code: int, payload: bytes, counter: int = 0, micros: int = 0) -> bytes:
    """A frame with a right CRC, whatever it says."""
    body = struct.pack("<BII", code, counter, micros) + payload
    return b"\0" + cobs.encode(body + struct.pack("<H", crc(body))) + b"\0"


def test_a_frame_is_these_bytes() -> None:
    frame = FrameEncoder("int16").frame([1, -2, 0], 0x01020304)
    assert frame.hex(" ") == "02 11 01 01 01 06 04 03 02 01 01 03 fe ff 01 03 d7 ae 00"


def test_the_crc_is_the_usual_one() -> None:
    assert crc(b"123456789") == 0x29B1


@pytest.mark.parametrize(
    ("sample_format", "given_values", "read"),
    [
        ("int16", [1, -2, 40_000, -40_000], (1, -2, 32_767, -32_768)),
        ("int32", [1.4, -(2**31), 2**40], (1, -(2**31), 2**31 - 1)),
        ("float32", [0.5, -1e20], (0.5, float(np.float32(-1e20)))),
    ],
)
def test_each_format_comes_back(
    sample_format: SampleFormat, given_values: list[float], read: tuple[float, ...]
) -> None:
    packets, rejected = decoded(FrameEncoder(sample_format).frame(given_values, 7))
    assert packets == [Packet(read, 7_000, anew=True)]
    assert rejected == {}


@given(st.lists(st.integers(1, 40), max_size=30))
def test_however_the_bytes_are_cut_every_sample_comes_once(cuts: list[int]) -> None:
    data, decoder, packets = b"".join(frames(10)), FrameDecoder(MS), []
    for first, last in itertools.pairwise([0, *itertools.accumulate(cuts), len(data)]):
        packets += decoder.feed(data[first:last])
    assert values(packets) == list(range(40))
    assert [packet.device_ns for packet in packets] == [(4 * i + 3) * MS for i in range(10)]
    assert not decoder.rejected


@given(garbage=st.binary(min_size=1, max_size=40), at=st.integers(0, 10_000))
def test_garbage_anywhere_costs_at_most_one_frame_and_the_loss_is_known(
    garbage: bytes, at: int
) -> None:
    data = b"".join(frames(8))
    at %= len(b"".join(frames(6)))
    packets, rejected = decoded(b"\0" + data[:at] + garbage + data[at:])
    assert set(values(packets)) <= set(range(32))
    assert len(values(packets)) >= 28
    first = values(packets)[0]
    assert first + len(values(packets)) + sum(packet.missing for packet in packets) == 32
    assert bool(rejected) or len(packets) == 8


def test_a_wrong_byte_at_every_offset_never_makes_a_wrong_sample() -> None:
    whole = frames(6)
    data = b"\0" + b"".join(whole)
    for at, change in itertools.product(range(1, len(b"".join(whole[:4]))), (1, 0x80, 0xFF)):
        spoilt = bytearray(data)
        spoilt[at] ^= change
        packets, rejected = decoded(bytes(spoilt))
        assert 4 <= len(packets) <= 5, at
        found = values(packets)
        assert found == sorted(set(found) & set(range(24)))
        assert sum(rejected.values()) >= 1
        assert found[0] + len(found) + sum(packet.missing for packet in packets) == 24


def test_half_a_frame_at_either_end_is_no_sample() -> None:
    one, two = frames(2)
    for cut in range(1, len(one)):
        packets, rejected = decoded(one[cut:] + two)
        assert values(packets) == [4, 5, 6, 7]
        assert rejected == ({} if cut == len(one) - 1 else {"partial": 1})
        assert decoded(one[: cut - 1]) == ([], {})


def test_noise_alone_makes_no_sample_and_no_memory_grows() -> None:
    decoder = FrameDecoder(MS)
    rng = np.random.default_rng(1)
    for _ in range(50):
        assert decoder.feed(rng.bytes(4096)) == []
    assert decoder.rejected["framing"] > 100
    without_zeros = bytes(rng.integers(1, 256, 100_000, dtype=np.uint8))
    before = decoder.rejected["framing"]
    for start in range(0, 100_000, 1000):
        assert decoder.feed(without_zeros[start : start + 1000]) == []
    assert decoder.rejected["framing"] == before + 1
    assert values(decoder.feed(b"\0" + frames(1)[0])) == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("data", "cause"),
    [
        (raw(0x11, b"")[1:], "framing"),
        (b"\x05\x01\0", "framing"),
        (raw(0x14, b"ab"), "format"),
        (raw(0x11, b"abc"), "format"),
        (raw(0x13, struct.pack("<f", float("nan"))), "not_finite"),
        (raw(0x13, struct.pack("<f", float("-inf"))), "not_finite"),
        (raw(0x13, struct.pack("<f", 1e31)), "not_finite"),
        (frames(1)[0].replace(b"\x11", b"\x12"), "crc"),
    ],
)
def test_what_is_no_frame_is_counted_by_its_cause(data: bytes, cause: str) -> None:
    assert decoded(b"\0" + data) == ([], {cause: 1})


def test_the_counter_tells_what_is_missing_when_the_time_agrees() -> None:
    sent = frames(30)
    packets, rejected = decoded(b"".join(sent[:10] + sent[25:]))
    assert [packet.missing for packet in packets] == [0] * 10 + [60] + [0] * 4
    assert rejected == {}


def test_a_counter_that_jumps_without_the_time_is_counted_and_not_believed() -> None:
    samples = struct.pack("<4h", 0, 1, 2, 3)
    data = raw(0x11, samples, counter=0, micros=3_000) + raw(
        0x11, samples, counter=1_000_000, micros=7_000
    )
    packets, rejected = decoded(data)
    assert [packet.missing for packet in packets] == [0, 0]
    assert rejected == {"counter": 1}


def test_counter_and_time_begin_again_at_zero_without_a_gap() -> None:
    samples = struct.pack("<4h", 0, 1, 2, 3)
    turn = 1 << 32
    data = raw(0x11, samples, turn - 4, turn - 1_000) + raw(0x11, samples, 0, 3_000)
    packets, rejected = decoded(data)
    first, second = packets
    assert first.device_ns is not None
    assert second == Packet((0, 1, 2, 3), first.device_ns + 4 * MS)
    assert rejected == {}


def test_a_board_that_begins_anew_says_so() -> None:
    packets, _ = decoded(b"".join(frames(3, first_ms=500_000) + frames(3)))
    assert [packet.anew for packet in packets] == [True, False, False, True, False, False]
    assert [packet.missing for packet in packets] == [0] * 6


def test_the_longest_frame_comes_through() -> None:
    packets, rejected = decoded(FrameEncoder("int32").frame([2**30] * MAX_SAMPLES, 1))
    assert len(values(packets)) == MAX_SAMPLES
    assert rejected == {}
