import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pulse_sensors.reading import Packet
from pulse_sensors.text_lines import TextDecoder, TimeUnit

MS = 1_000_000


def untimed(data: bytes, column: int = 0) -> tuple[list[Packet], dict[str, int]]:
    decoder = TextDecoder(MS, column, None)
    return decoder.feed(b"\n" + data), dict(decoder.rejected)


def timed(data: bytes, unit: TimeUnit = "us") -> tuple[list[Packet], dict[str, int]]:
    """Fed line by line, so that each is a packet."""
    decoder = TextDecoder(MS, 0, unit)
    decoder.feed(b"\n")
    packets = [packet for line in data.split(b"\n") for packet in decoder.feed(line + b"\n")]
    return packets, dict(decoder.rejected)


def lines(numbers: range) -> bytes:
    """A line a ms: line i has the time i ms and the value i."""
    return b"".join(b"%d,%d\r\n" % (i * 1_000, i) for i in numbers)


def values(packets: list[Packet]) -> list[float]:
    return [value for packet in packets for value in packet.values]


@pytest.mark.parametrize(
    ("text", "column", "value"),
    [
        (b"0.25\n", 0, 0.25),
        (b" 0.25 \r\n", 0, 0.25),
        (b"+2.5e-1\r", 0, 0.25),
        (b"1,0.25\n", 1, 0.25),
        (b"1;\t0.25 ; 7\n", 1, 0.25),
        (b"force:0.25,temperature:31\n", 0, 0.25),
    ],
)
def test_a_line_is_read_as_sketches_print_it(text: bytes, column: int, value: float) -> None:
    assert untimed(text, column) == ([Packet((value,))], {})


@pytest.mark.parametrize("unit", ["us", "ms", "s"])
def test_a_time_comes_before_the_value(unit: TimeUnit) -> None:
    per_second = {"us": 1e6, "ms": 1e3, "s": 1.0}[unit]
    text = b"".join(b"%.6f 0.5\n" % (second * per_second) for second in (1.0, 1.001))
    packets, rejected = timed(text, unit)
    assert packets == [Packet((0.5,), 1_000 * MS, anew=True), Packet((0.5,), 1_001 * MS)]
    assert rejected == {}


@pytest.mark.parametrize(
    "line", [b"", b"x", b"0.2.5", b"nan", b"inf", b"1e31", b"\xff\xfe", b"force:", b"1," * 99]
)
def test_what_is_no_number_is_counted_and_known_to_be_missing(line: bytes) -> None:
    packets, rejected = untimed(b"1\n2\n" + line + b"\n3\n4\n", column=0)
    if line in (b"", b"1," * 99):
        assert rejected == {}
        assert values(packets)[:2] == [1, 2]
        return
    assert packets == [Packet((1, 2)), Packet((3, 4), missing=1)]
    assert rejected == {"not_a_number": 1}


def test_a_column_that_is_not_there_is_counted() -> None:
    assert untimed(b"1,2\n1\n1,4\n", column=1) == (
        [Packet((2,)), Packet((4,), missing=1)],
        {"not_a_number": 1},
    )


@given(st.lists(st.integers(1, 30), max_size=30))
def test_however_the_bytes_are_cut_every_line_comes_once(cuts: list[int]) -> None:
    data, decoder, packets = lines(range(30)), TextDecoder(MS, 0, "us"), []
    for first, last in itertools.pairwise([0, *itertools.accumulate(cuts), len(data)]):
        packets += decoder.feed(data[first:last])
    assert values(packets) == list(range(1, 30))
    assert decoder.rejected == {"partial": 1}


def test_the_rest_of_a_line_before_the_first_is_not_believed() -> None:
    decoder = TextDecoder(MS, 0, None)
    assert decoder.feed(b"25\n0.26\n") == [Packet((0.26,))]
    assert decoder.rejected == {"partial": 1}


@given(garbage=st.binary(min_size=1, max_size=40), at=st.integers(0, 10_000))
def test_after_garbage_anywhere_the_stream_goes_on(garbage: bytes, at: int) -> None:
    data = lines(range(40))
    at %= len(lines(range(20)))
    packets, _ = timed(data[:at] + garbage + data[at:])
    assert values(packets)[-10:] == list(range(30, 40))


def test_lines_that_come_together_are_one_packet_with_the_last_ones_time() -> None:
    decoder = TextDecoder(MS, 0, "us")
    text = lines(range(1, 6)) + b"x\n" + lines(range(7, 9))
    assert decoder.feed(b"\n" + text) == [
        Packet((1, 2, 3, 4, 5), 5 * MS, anew=True),
        Packet((7, 8), 8 * MS, missing=1),
    ]


def test_a_wrong_time_is_not_believed() -> None:
    text = lines(range(10)) + b"9910000,10\r\n" + lines(range(11, 20))
    packets, rejected = timed(text)
    assert values(packets) == [*range(10), *range(11, 20)]
    assert [packet.missing for packet in packets if packet.missing] == [1]
    assert rejected == {"device_time": 1}


def test_a_jump_of_the_time_is_believed_when_the_next_line_goes_on_from_it() -> None:
    packets, rejected = timed(lines(range(10)) + lines(range(60, 70)))
    assert values(packets) == [*range(10), *range(61, 70)]
    assert packets[10] == Packet((61,), 61 * MS, missing=51)
    assert rejected == {"device_time": 1}


def test_a_board_that_begins_anew_says_so() -> None:
    packets, _ = timed(lines(range(5000, 5010)) + lines(range(10)))
    assert [packet.anew for packet in packets] == [True] + [False] * 9 + [True] + [False] * 8


@pytest.mark.parametrize("period_us", [700, 1_000, 1_300])
def test_a_loop_off_its_rate_misses_nothing(period_us: int) -> None:
    text = b"".join(b"%d,1\n" % (i * period_us) for i in range(2_000))
    packets, rejected = timed(text)
    assert sum(packet.missing for packet in packets) == 0
    assert rejected == {}


def test_the_true_period_is_learnt_and_tells_how_many_lines_are_missing() -> None:
    text = b"".join(b"%d,1\n" % (i * 1_400) for i in range(2_000) if i != 1_500)
    packets, _ = timed(text)
    assert sum(packet.missing for packet in packets) == 1


def test_times_in_whole_milliseconds_miss_nothing_by_rounding() -> None:
    text = b"".join(b"%d,1\n" % (i * 1_003 // 1_000) for i in range(5_000))
    packets, rejected = timed(text, "ms")
    assert sum(packet.missing for packet in packets) == 0
    assert len(packets) == 5_000
    assert rejected == {}


def test_micros_begin_again_at_zero_without_a_gap() -> None:
    turn = 1 << 32
    text = b"".join(b"%d,1\n" % (us % turn) for us in range(turn - 3_000, turn + 3_000, 1_000))
    packets, rejected = timed(text)
    times = [packet.device_ns for packet in packets if packet.device_ns is not None]
    assert np.diff(times).tolist() == [MS] * 5
    assert [packet.anew for packet in packets] == [True] + [False] * 5
    assert rejected == {}


def test_noise_alone_makes_no_sample_and_no_memory_grows() -> None:
    decoder = TextDecoder(MS, 0, "us")
    rng = np.random.default_rng(1)
    for _ in range(100):
        assert decoder.feed(rng.bytes(1000)) == []
    assert sum(decoder.rejected.values()) > 100
    decoder.feed(b"\n")
    before = decoder.rejected["framing"]
    for _ in range(100):
        assert decoder.feed(b"x" * 1000) == []
    assert decoder.rejected["framing"] == before + 1
    assert values(decoder.feed(b"\n" + lines(range(5)))) == [0, 1, 2, 3, 4]
