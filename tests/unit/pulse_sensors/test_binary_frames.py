import itertools
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.serial_frames import crc, encode_frame
from pulse_sensors.binary_frames import MAX_SAMPLES, FrameDecoder, FrameEncoder, SampleFormat
from tests.support.sample_blocks import Decoded, plain, values

MS = 1_000_000
FRAME = 4
SAMPLES = struct.pack("<4h", 0, 1, 2, 3)
TURN = 1 << 32


def frames(count: int, first_ms: int = 0) -> list[bytes]:
    """Return frames of 4 samples, one sample a ms: sample i has the value i."""
    encoder = FrameEncoder("int16")
    return [
        encoder.frame(range(i, i + FRAME), (first_ms + i + FRAME - 1) * 1_000)
        for i in range(0, count * FRAME, FRAME)
    ]


def decoded(data: bytes) -> tuple[list[Decoded], dict[str, int]]:
    decoder = FrameDecoder(MS)
    return plain(decoder.feed(data)), dict(decoder.rejected)


def account(blocks: list[Decoded]) -> float:
    """Return the number of the next sample, by the values and the missing samples."""
    return values(blocks)[0] + len(values(blocks)) + sum(block.missing for block in blocks)


def raw(code: int, payload: bytes, counter: int = 0, micros: int = 0) -> bytes:
    """Return a frame with any content and a right CRC."""
    return b"\0" + encode_frame(struct.pack("<BII", code, counter, micros) + payload)


def test_a_frame_has_known_bytes() -> None:
    frame = FrameEncoder("int16").frame([1, -2, 0], 0x01020304)
    assert frame.hex(" ") == "02 11 01 01 01 06 04 03 02 01 01 03 fe ff 01 03 d7 ae 00"
    assert crc(b"123456789") == 0x29B1


@pytest.mark.parametrize(
    ("sample_format", "sent", "read"),
    [
        ("int16", [1, -2, 40_000, -40_000], (1, -2, 32_767, -32_768)),
        ("int32", [1.4, -(2**31), 2**40], (1, -(2**31), 2**31 - 1)),
        ("float32", [0.5, -1e20], (0.5, float(np.float32(-1e20)))),
        ("int32", [2**30] * MAX_SAMPLES, (2**30,) * MAX_SAMPLES),
    ],
)
def test_each_format_is_decoded(
    sample_format: SampleFormat, sent: list[float], read: tuple[float, ...]
) -> None:
    frame = FrameEncoder(sample_format).frame(sent, 7)
    assert decoded(frame) == ([Decoded(read, 7_000, restarted=True)], {})


@given(st.lists(st.integers(1, 40), max_size=30))
def test_every_sample_comes_once_however_the_bytes_are_divided(cuts: list[int]) -> None:
    data, decoder, blocks = b"".join(frames(10)), FrameDecoder(MS), []
    for first, last in itertools.pairwise([0, *itertools.accumulate(cuts), len(data)]):
        blocks += plain(decoder.feed(data[first:last]))
    assert values(blocks) == list(range(40))
    assert [block.device_ns for block in blocks] == [(4 * i + 3) * MS for i in range(10)]
    assert not decoder.rejected


@given(garbage=st.binary(min_size=1, max_size=40), at=st.integers(0, 10_000))
def test_garbage_costs_at_most_one_frame_and_the_loss_is_counted(garbage: bytes, at: int) -> None:
    data = b"".join(frames(8))
    at %= len(b"".join(frames(6)))
    blocks, rejected = decoded(b"\0" + data[:at] + garbage + data[at:])
    assert set(values(blocks)) <= set(range(32))
    assert len(values(blocks)) >= 28
    assert account(blocks) == 32
    assert bool(rejected) or len(blocks) == 8


def test_a_wrong_byte_at_every_offset_never_makes_a_wrong_sample() -> None:
    whole = frames(6)
    data = b"\0" + b"".join(whole)
    for at, change in itertools.product(range(1, len(b"".join(whole[:4]))), (1, 0x80, 0xFF)):
        spoilt = bytearray(data)
        spoilt[at] ^= change
        blocks, rejected = decoded(bytes(spoilt))
        assert 4 <= len(blocks) <= 5, at
        found = values(blocks)
        assert found == sorted(set(found) & set(range(24)))
        assert sum(rejected.values()) >= 1
        assert account(blocks) == 24


def test_a_partial_frame_at_either_end_is_no_sample() -> None:
    one, two = frames(2)
    for cut in range(1, len(one)):
        blocks, rejected = decoded(one[cut:] + two)
        assert values(blocks) == [4, 5, 6, 7]
        assert rejected == ({} if cut == len(one) - 1 else {"partial": 1})
        assert decoded(one[: cut - 1]) == ([], {})


def test_noise_gives_no_sample_and_uses_bounded_memory() -> None:
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
    assert values(plain(decoder.feed(b"\0" + frames(1)[0]))) == [0, 1, 2, 3]


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
def test_an_invalid_frame_is_counted_by_its_cause(data: bytes, cause: str) -> None:
    assert decoded(b"\0" + data) == ([], {cause: 1})


@pytest.mark.parametrize(
    ("data", "missing", "restarted", "rejected"),
    [
        # 15 frames are lost, and the time agrees.
        (b"".join(frames(30)[:2] + frames(30)[17:]), [0, 0, 60, *[0] * 12], [0], {}),
        # The counter jumps without the time.
        (raw(0x11, SAMPLES, 0, 3_000) + raw(0x11, SAMPLES, 1_000_000, 7_000), [0, 0], [0],
         {"counter": 1}),
        # Counter and time wrap to 0.
        (raw(0x11, SAMPLES, TURN - 4, TURN - 1_000) + raw(0x11, SAMPLES, 0, 3_000), [0] * 2, [0],
         {}),
        # The board restarts.
        (b"".join(frames(3, first_ms=500_000) + frames(3)), [0] * 6, [0, 3], {}),
    ],
)  # fmt: skip
def test_counter_and_time_reveal_losses_and_restarts(
    data: bytes, missing: list[int], restarted: list[int], rejected: dict[str, int]
) -> None:
    blocks, counted = decoded(data)
    assert [block.missing for block in blocks] == missing
    assert [number for number, block in enumerate(blocks) if block.restarted] == restarted
    assert counted == rejected
    for before, after in itertools.pairwise(blocks):
        assert before.device_ns is not None
        if not after.restarted:
            assert after.device_ns == before.device_ns + (4 + after.missing) * MS
