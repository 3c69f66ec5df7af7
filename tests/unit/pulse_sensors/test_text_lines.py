import itertools
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pulse_sensors.text_lines import TextDecoder, TimeUnit
from tests.support.sample_blocks import Decoded, plain, values

MS = 1_000_000
TURN = 1 << 32


def untimed(data: bytes, column: int = 0) -> tuple[list[Decoded], dict[str, int]]:
    decoder = TextDecoder(MS, (column,), None)
    return plain(decoder.feed(b"\n" + data)), dict(decoder.rejected)


def timed(data: bytes, unit: TimeUnit = "us") -> tuple[list[Decoded], dict[str, int]]:
    """Decode line by line, so that each line is a block."""
    decoder = TextDecoder(MS, (0,), unit)
    decoder.feed(b"\n")
    blocks = [block for line in data.split(b"\n") for block in decoder.feed(line + b"\n")]
    return plain(blocks), dict(decoder.rejected)


def lines(*ranges: range) -> bytes:
    """Return lines of which line i has the time i ms and the value i."""
    return b"".join(b"%d,%d\r\n" % (i * 1_000, i) for i in itertools.chain(*ranges))


@pytest.mark.parametrize(
    ("text", "column", "value"),
    [
        (b"0.25\n", 0, 0.25), (b" 0.25 \r\n", 0, 0.25), (b"+2.5e-1\r", 0, 0.25),
        (b"1,0.25\n", 1, 0.25), (b"1;\t0.25 ; 7\n", 1, 0.25),
        (b"force:0.25,temperature:31\n", 0, 0.25),
        # With labels and units, as in files.
        (b"Force: 0.345 N\n", 0, 0.345), (b"IR=51234 RED=40000\n", 1, 40_000),
        (b"S512\n", 0, 512), (b"0.345 N\n", 0, 0.345), (b"0.345N, 31 C\n", 1, 31),
        (b"IR=51234, BPM=60.1 No finger?\n", 1, 60.1), (b'{"ir": 5, "red": 6.5}\n', 1, 6.5),
        (b"Avg Force (N): -2.5e-1\n", 0, -0.25),
    ],
)  # fmt: skip
def test_lines_as_sketches_print_them_are_decoded(text: bytes, column: int, value: float) -> None:
    assert untimed(text, column) == ([Decoded((value,))], {})


@pytest.mark.parametrize(("unit", "per_second"), [("us", 1e6), ("ms", 1e3), ("s", 1.0)])
def test_a_time_comes_before_the_value(unit: TimeUnit, per_second: float) -> None:
    text = b"".join(b"%.6f 0.5\n" % (second * per_second) for second in (1.0, 1.001))
    first, second = Decoded((0.5,), 1_000 * MS, restarted=True), Decoded((0.5,), 1_001 * MS)
    assert timed(text, unit) == ([first, second], {})


@pytest.mark.parametrize("line", [b"x", b"0.2.5", b"nan", b"inf", b"1e31", b"\xff\xfe", b"force:"])
def test_a_line_without_a_number_counts_as_missing(line: bytes) -> None:
    blocks = [Decoded((1, 2)), Decoded((3, 4), missing=1)]
    assert untimed(b"1\n2\n" + line + b"\n3\n4\n") == (blocks, {"not_a_number": 1})
    blocks = [Decoded((2,)), Decoded((4,), missing=1)]
    assert untimed(b"1,2\n1," + line + b"\n1,4\n", column=1) == (blocks, {"not_a_number": 1})
    assert untimed(b"1,2\n1\n1,4\n", column=1) == (blocks, {"not_a_number": 1})


@given(st.lists(st.integers(1, 30), max_size=30))
def test_every_line_comes_once_however_the_bytes_are_divided(cuts: list[int]) -> None:
    data, decoder, blocks = lines(range(30)), TextDecoder(MS, (0,), "us"), []
    for first, last in itertools.pairwise([0, *itertools.accumulate(cuts), len(data)]):
        blocks += plain(decoder.feed(data[first:last]))
    # The first line may be incomplete.
    assert values(blocks) == list(range(1, 30))
    assert decoder.rejected == {"partial": 1}


@given(garbage=st.binary(min_size=1, max_size=40), at=st.integers(0, 10_000))
def test_after_garbage_the_stream_continues(garbage: bytes, at: int) -> None:
    data = lines(range(40))
    at %= len(lines(range(20)))
    blocks, _ = timed(data[:at] + garbage + data[at:])
    assert values(blocks)[-10:] == list(range(30, 40))


@pytest.mark.parametrize(
    ("text", "refused", "missing", "restarted"),
    [
        # A wrong time.
        (lines(range(10)) + b"9910000,10\r\n" + lines(range(11, 20)), [10], {11: 1}, [0]),
        # A jump, which the next line confirms.
        (lines(range(10), range(60, 70)), [60], {61: 51}, [0]),
        # A restart, which the next line confirms.
        (lines(range(5000, 5010), range(10)), [0], {}, [5000, 1]),
    ],
)
def test_a_time_that_does_not_follow_must_be_confirmed(
    text: bytes, refused: list[int], missing: dict[float, int], restarted: list[int]
) -> None:
    blocks, rejected = timed(text)
    sent = [float(line.rpartition(b",")[2]) for line in text.split()]
    assert values(blocks) == [value for value in sent if value not in refused]
    assert {block.values[0]: block.missing for block in blocks if block.missing} == missing
    assert [block.values[0] for block in blocks if block.restarted] == restarted
    assert rejected == {"device_time": 1}


@pytest.mark.parametrize(
    ("times", "unit", "missing"),
    [
        # The sketch's loop has another rate.
        *(([i * us for i in range(2_000)], "us", 0) for us in (700, 1_000, 1_300)),
        # The true period is learnt, and reveals one lost line.
        ([i * 1_400 for i in range(2_000) if i != 1_500], "us", 1),
        # Rounding to milliseconds loses nothing.
        ([i * 1_003 // 1_000 for i in range(5_000)], "ms", 0),
        # Two lines in one millisecond.
        ([i * 990 // 1_000 for i in range(5_000)], "ms", 0),
        # micros() wraps to 0.
        ([us % TURN for us in range(TURN - 3_000, TURN + 3_000, 1_000)], "us", 0),
    ],
)
def test_losses_follow_from_the_times(times: list[int], unit: TimeUnit, missing: int) -> None:
    blocks, rejected = timed(b"".join(b"%d,1\n" % time for time in times), unit)
    assert sum(block.missing for block in blocks) == missing
    assert len(blocks) == len(times)
    assert [block.restarted for block in blocks] == [True] + [False] * (len(times) - 1)
    device_ns = [block.device_ns for block in blocks if block.device_ns is not None]
    passed_ns = np.diff(times) % TURN * (MS if unit == "ms" else 1_000)
    np.testing.assert_array_equal(np.diff(device_ns), passed_ns)
    assert rejected == {}


@pytest.mark.parametrize("unit_us", [1_000, 1_024])
@pytest.mark.parametrize("period_us", [100, 250, 500, 1_000, 1_010])
def test_no_line_is_lost_where_a_board_counts_in_milliseconds(unit_us: int, period_us: int) -> None:
    """millis() of an Arduino Uno counts in 1.024 ms."""
    decoder, times_us = TextDecoder(period_us * 1_000, (0,), "ms"), range(0, 2_000_000, period_us)
    decoder.feed(b"\n")
    sent = [(us // unit_us * unit_us // 1_000, number) for number, us in enumerate(times_us)]
    blocks = [block for line in sent for block in plain(decoder.feed(b"%d,%d\n" % line))]
    assert values(blocks) == list(range(len(times_us)))
    assert decoder.rejected == {}
    assert sum(block.missing for block in blocks) == 0


@pytest.mark.parametrize("unit", ["us", "ms"])
def test_a_clock_that_stands_still_is_refused(unit: TimeUnit) -> None:
    """Its resolution may be 0.1 s."""
    _, rejected = timed(b"7,1\n" * 300, unit)
    assert rejected == {"device_time": 200}


COARSE = [
    # As Arduino prints a float: two decimals.
    (1_000, lambda us: f"{us * 1e-6:.2f}", "s", "10 ms"),
    (250, lambda us: f"{us * 1e-6:.2f}", "s", ""),
    (100, lambda us: f"{us * 1e-6:.2f}", "s", ""),
    (50, lambda us: f"{us * 1e-6:.2f}", "s", ""),
    (500, lambda us: f"{us * 1e-6:.1f}", "s", "100 ms"),
    # More decimals than the clock has, and whole numbers of a clock with slow ticks.
    (1_000, lambda us: f"{us // 10_000 * 1e-2:.3f}", "s", "10 ms"),
    (1_000, lambda us: f"{(us + 7_000) // 10_000 * 1e-2:.3f}", "s", "10 ms"),
    (1_000, lambda us: f"{us // 16_000 * 16}", "ms", "16 ms"),
    (1_000, lambda us: f"{us // 1_024 * 1_024 // 1_000}", "ms", ""),
    (1_000, lambda us: f"{us // 50_000 * 50_000}", "us", "50 ms"),
]


@pytest.mark.parametrize(("rate_hz", "stamp", "unit", "steps"), COARSE)
def test_coarse_device_times_lose_no_sample(
    rate_hz: int, stamp: Callable[[int], str], unit: TimeUnit, steps: str, logged: list[str]
) -> None:
    decoder, count = TextDecoder(1_000_000_000 // rate_hz, (0,), unit), 8 * rate_hz
    decoder.feed(b"\n")
    sent = [f"{stamp(n * 1_000_000 // rate_hz)},{n}\n".encode() for n in range(count)]
    blocks = [block for line in sent for block in plain(decoder.feed(line))]
    assert values(blocks) == list(range(count))
    assert sum(block.missing for block in blocks) == 0
    assert decoder.rejected == {}
    assert [block.restarted for block in blocks[1:]] == [False] * (count - 1)
    # Times that tell less than those of arrival are left out, which is said once.
    assert len(logged) == bool(steps)
    assert (blocks[-1].device_ns is None) == bool(steps)
    if steps:
        assert f"step by {steps}, " in logged[0]


def test_noise_in_the_decimals_of_a_time_makes_no_clock_coarse(logged: list[str]) -> None:
    text = b"".join(b"%.3f,1\n" % (n * 1e-3) for n in range(500))
    timed(text.replace(b"0.301,", b"0,").replace(b"0.302,", b"0.3,"), "s")
    assert logged == []


@pytest.mark.parametrize(
    ("unit", "line", "value"),
    [
        ("N", b"Force: 345 mN", 0.345), ("mN", b"0.345 N", 345.0), ("mV", b"A0: 2.5V", 2500.0),
        ("N", b"Force: 0.3 newtons", 0.3), ("counts", b"Force: 512 N", 512.0),
        ("N", b"A0: 2.5 V", "unit"), ("N", b"Load: 34.5 g", "unit"),
    ],
)  # fmt: skip
def test_a_number_has_the_unit_of_its_line(unit: str, line: bytes, value: float | str) -> None:
    decoder = TextDecoder(MS, (0,), None, (unit,))
    read = values(plain(decoder.feed(b"\n" + line + b"\n")))
    if isinstance(value, str):
        assert (read, decoder.rejected) == ([], {value: 1})
        assert f'the scene says unit = "{unit}"' in decoder.refused[value]
    else:
        assert read == pytest.approx([value])


def test_lines_of_several_kinds_are_no_signal_until_one_is_chosen() -> None:
    lines = b"".join(b"IR=%d\nRED=%d\n" % (n, -n) for n in range(100))
    blocks, rejected = untimed(lines)
    assert values(blocks) == [0]
    assert rejected == {"labels": 199}
    chosen = TextDecoder(MS, ("RED",), None)
    blocks = plain(chosen.feed(b"\n" + lines))
    assert values(blocks) == [-n for n in range(100)]
    # The others are not lost samples.
    assert sum(block.missing for block in blocks) == chosen.rejected.total() == 0
    absent = TextDecoder(MS, ("GREEN",), None)
    assert absent.feed(b"\n" + lines) == []
    assert absent.refused["labels"] == "the line 'RED=-99' has no 'GREEN', but RED: set column"


def test_a_signal_keeps_its_label_where_lines_of_other_kinds_come_between() -> None:
    """As sketches for pulse sensors print a beat: its rate and its interval."""
    blocks, rejected = untimed(b"B72\nQ800\nS512\nS513\nB72\nQ800\nS514\nS515\n")
    assert values(blocks) == [72, 513, 514, 515]
    assert rejected == {"labels": 4}
    blocks, _ = untimed(b"IR=1 RED=2\nIR=3 RED=4\nIR5 RED=6\nIR=7 RED=8\n")
    assert values(blocks) == [1, 3, 7]


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (b"ready", "the line 'ready' has 'ready' where a number was expected: set column to"),
        (b"\x1b[2J\x80", 'is no text: set framing = "binary", or baud to that of the sketch'),
        (b"F: 0,345", "the line 'F: 0,345' has '0,345' where a number was expected"),
        (b"F: 0.3#45 N", "has '0.3#45' where a number was expected"),
    ],
)
def test_a_line_that_cannot_be_read_is_quoted_with_what_to_set(line: bytes, text: str) -> None:
    decoder = TextDecoder(MS, (0,), None)
    assert decoder.feed(b"\n" + line + b"\n") == []
    assert text in decoder.refused["not_a_number"]


def test_noise_gives_no_sample_and_uses_bounded_memory() -> None:
    decoder = TextDecoder(MS, (0,), "us")
    rng = np.random.default_rng(1)
    for _ in range(100):
        assert decoder.feed(rng.bytes(1000)) == []
    assert sum(decoder.rejected.values()) > 100
    decoder.feed(b"\n")
    before = decoder.rejected["framing"]
    for _ in range(100):
        assert decoder.feed(b"x" * 1000) == []
    assert decoder.rejected["framing"] == before + 1
    assert values(plain(decoder.feed(b"\n" + lines(range(5))))) == [0, 1, 2, 3, 4]
