"""Samples of an emulated board and their times on the host, in virtual time."""

import math
import re
from collections import Counter
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from protocol.config.scene import validate
from protocol.wire.messages import Frame, decode_frame, encode_frame
from pulse_sensors.samples import JUMP_NS, SampleBlock, Timeline, Timestamper, decoded_block
from pulse_sensors.serial_port import SerialScene
from sensing_node.feeds import Framer
from telepulse.emulators.sensor_board import BoardBehaviour, SensorBoard, binary, line, timed_line
from tests.support.sample_blocks import forces
from tests.support.streams import description, synthetic

START_NS = 10**15
MS, SECOND_NS = 1_000_000, 1_000_000_000
KEYS = {"kind": "serial", "port": "none", "rate": "1 kHz", "unit": "N"}
SCENES = {
    "binary": KEYS | {"framing": "binary"},
    "text": KEYS | {"framing": "text", "device_time": "us"},
    "untimed": KEYS | {"framing": "text"},
}


def timestamper(kind: str = "untimed") -> Timestamper:
    return Timestamper(validate(SCENES[kind], SerialScene, "scene"))


class Transmission(NamedTuple):
    """A board, and its samples on the host."""

    board: SensorBoard
    timestamper: Timestamper
    rejected: Counter[str]
    timestamped: list[SampleBlock]
    arrivals_ns: list[int]

    @property
    def samples(self) -> int:
        return len(forces(self.timestamped))

    def errors_ms(self, after_s: float) -> NDArray[np.float64]:
        """Return the error of each block's time, from `after_s` on."""
        counts = [(block.missing, len(block.values)) for block in self.timestamped]
        ends = np.cumsum([missing + count for missing, count in counts])
        firsts = ends - [count for _, count in counts]
        true_ns = np.array([self.board.taken_ns(number) for number in firsts.tolist()])
        errors_ms = (np.array([block.first_ns for block in self.timestamped]) - true_ns) * 1e-6
        return np.asarray(errors_ms[true_ns > START_NS + after_s * 1e9])


def transmit(kind: str, seconds: float, lost: range = range(0), **behaviour: float) -> Transmission:
    """Run a board whose deliveries in `lost` do not arrive."""
    encode = {"binary": binary("float32"), "text": timed_line, "untimed": line}[kind]
    given = BoardBehaviour(4 if kind == "binary" else 1, **behaviour)
    board = SensorBoard(synthetic(), encode, given, START_NS)
    decoder = validate(SCENES[kind], SerialScene, "scene").decoder()
    decoder.feed(b"\0" if kind == "binary" else b"\n")
    sent = Transmission(board, timestamper(kind), decoder.rejected, [], [])
    delivery = 0
    while (now_ns := board.next_delivery_ns) < START_NS + seconds * SECOND_NS:
        data = board.deliver(now_ns)
        for block in decoder.feed(data) if delivery not in lost else ():
            timestamped = sent.timestamper.timestamp(block, now_ns)
            assert timestamped is not None
            sent.timestamped.append(timestamped)
            sent.arrivals_ns.append(now_ns)
        delivery += 1
    return sent


@pytest.mark.parametrize("kind", list(SCENES))
@pytest.mark.parametrize("skew", [50e-6, -200e-6, 3e-3])
def test_usb_batches_do_not_jitter_the_times(kind: str, skew: float) -> None:
    sent = transmit(kind, 20, skew=skew)
    errors_ms = sent.errors_ms(after_s=5)
    assert np.diff(sent.arrivals_ns).max() > 14 * MS
    assert errors_ms.std() < 0.1
    assert abs(errors_ms).max() < 0.8
    assert (sent.timestamper.missing, sent.samples) == (0, sent.board.sampled)
    true_n = synthetic().take(sent.samples)[:, 0]
    np.testing.assert_allclose(forces(sent.timestamped), true_n, atol=1e-6)
    if kind != "untimed":
        assert sent.timestamper.clock.skew_ppm == pytest.approx(skew * 1e6, abs=5)


@pytest.mark.parametrize("kind", ["binary", "text"])
@pytest.mark.parametrize("lost", [range(300, 301), range(300, 310), range(300, 500)])
def test_lost_samples_are_counted_as_missing(kind: str, lost: range) -> None:
    sent = transmit(kind, 10, lost=lost)
    assert sent.timestamper.missing > 0
    # Text has no counter; the next line confirms a jump of the time.
    account = sent.samples + sent.timestamper.missing
    assert account == pytest.approx(sent.board.sampled, abs=1)
    assert abs(sent.errors_ms(after_s=5)).max() < 1.5


def test_a_restart_of_the_board_is_counted() -> None:
    under_test = timestamper("binary")
    for first_s, device_s in ((0, 900), (3, 0)):
        for ms in range(2000):
            block = decoded_block([0.5], device_s * SECOND_NS + ms * MS, restarted=ms == 0)
            arrival_ns = START_NS + first_s * SECOND_NS + ms * MS
            timestamped = under_test.timestamp(block, arrival_ns)
            assert timestamped is not None
            assert abs(timestamped.first_ns - arrival_ns) < MS
    assert (under_test.samples, under_test.missing, under_test.restarts) == (4000, 1000, 1)
    assert under_test.faults("the board") == [
        "1000 samples missing from the board",
        "the board restarted its clock 1 time",
    ]


@pytest.mark.parametrize("kind", ["binary", "untimed"])
@pytest.mark.parametrize("hz", [100, 500, 800, 1300, 3000])
def test_a_lasting_wrong_rate_is_named_while_the_sensor_runs(kind: str, hz: int) -> None:
    """The timeline's own rate ends at 667 Hz and 2 kHz, and beyond, it loses or refuses samples."""
    under_test, name, faults = timestamper(kind), "the board", list[str | None]()
    assert under_test.faults(name) == ["no sample came from the board"]
    for number in range(0, 6 * hz, 4):
        at_ns = (number + 3) * SECOND_NS // hz
        device_ns = at_ns if kind == "binary" else None
        block = decoded_block([0.5] * 4, device_ns, restarted=not number)
        # USB delivers every 16 ms.
        under_test.timestamp(block, START_NS + math.ceil(at_ns / (16 * MS)) * 16 * MS)
        faults.append(under_test.rate.fault(name))
    named = [
        re.fullmatch(rf"{name} sends (\d+) Hz, the scene says 1000 Hz: check its rate", fault)
        for fault in faults
        if fault is not None
    ]
    assert [float(each[1]) for each in named if each] == pytest.approx([hz] * len(named), rel=0.02)
    assert 2 * hz // 4 <= faults.count(None) < 4 * hz // 4
    assert None not in faults[faults.count(None) :]
    assert under_test.faults(name)[-1] == faults[-1]


def test_lost_samples_and_pauses_do_not_change_the_rate_that_is_named() -> None:
    """A board loses each tenth block, which its counter shows, and once it is silent for 2 s."""
    under_test = timestamper("binary")
    for number in range(0, 4800, 4):
        if number // 4 % 10 == 9:
            continue
        at_ns = number * SECOND_NS // 800 + (number > 2400) * 2 * SECOND_NS
        missing = 4 if number // 4 % 10 == 0 and number else 0
        under_test.timestamp(decoded_block([0.5] * 4, at_ns, missing), START_NS + at_ns)
    fault = under_test.rate.fault("the board")
    assert fault is not None
    assert fault.startswith("the board sends 800 Hz")


def test_a_right_rate_is_no_fault_however_the_samples_jitter_or_pause() -> None:
    under_test = timestamper()
    for number in range(20_000):
        at_ns = number * MS + number // 7000 * SECOND_NS
        under_test.timestamp(decoded_block([0.5]), START_NS + math.ceil(at_ns / 4e7) * 40 * MS)
        assert under_test.rate.fault("the board") is None
    (missing,) = under_test.faults("the board")
    assert missing.endswith("samples missing from the board")


def times_of(
    timeline: Timeline, count: int, period_ns: float, jitter_ns: float = 0
) -> list[tuple[int, int, int]]:
    """Return the times of blocks of 4 samples that were measured with jitter."""
    rng = np.random.default_rng(1)
    last_ns = [
        START_NS + round((first + 3) * period_ns + rng.uniform(0, jitter_ns))
        for first in range(0, count, 4)
    ]
    times_ns = [timeline.place(4, 0, last) for last in last_ns]
    return [each for each in times_ns if each is not None]


def at_ms(first: float, end: float, missing: int) -> tuple[float, float, int]:
    return START_NS + first * MS, START_NS + end * MS, missing


@pytest.mark.parametrize("rate_hz", [700, 990, 1000, 1000.3, 1300])
def test_the_true_rate_is_found_and_the_jitter_removed(rate_hz: float) -> None:
    timeline = Timeline(MS)
    times_ns = times_of(timeline, 20_000, 1e9 / rate_hz, jitter_ns=8 * MS)
    assert len(times_ns) == 5_000
    assert timeline.rate_hz == pytest.approx(rate_hz, rel=1e-3)
    firsts_ns = np.array([first_ns for first_ns, _, _ in times_ns[2500:]]) - START_NS
    errors_ns = firsts_ns - np.arange(4 * 2500, 20_000, 4) * 1e9 / rate_hz
    assert errors_ns.std() < 0.25 * MS  # measured: 2.3 ms
    assert errors_ns.mean() == pytest.approx(4 * MS, abs=0.3 * MS)


def test_blocks_are_contiguous_and_never_step_back_with_any_jitter() -> None:
    timeline, rng, end_before_ns = Timeline(MS), np.random.default_rng(2), None
    for number in range(2000):
        place = timeline.place(1, 0, START_NS + number * MS + int(rng.normal(0, 60 * MS)))
        if place is None:
            continue
        first_ns, end_ns, missing = place
        assert end_ns > first_ns
        if end_before_ns is not None and not missing:
            assert first_ns == end_before_ns
            # A display refuses frames with less than half or more than twice the nominal period.
            assert 0.5 * MS < end_ns - first_ns < 2 * MS
        end_before_ns = end_ns


def test_gaps_keep_their_time_and_past_times_are_refused() -> None:
    known, jump, behind = Timeline(MS), Timeline(MS), Timeline(MS)
    for timeline in (known, jump, behind):
        times_of(timeline, 1000, MS)
    assert known.place(1, 7, START_NS + 1007 * MS) == at_ms(1007, 1008, 7)
    assert jump.place(1, 0, START_NS + 6000 * MS) == at_ms(6000, 6001, 5000)
    assert behind.place(1, 0, START_NS + 999 * MS - JUMP_NS) is None
    assert behind.place(1, 0, START_NS + 1000 * MS) == at_ms(1000, 1001, 0)


def test_samples_lost_before_the_first_one_delay_none() -> None:
    under_test, lost = timestamper("binary"), 5_000
    blocks = [
        under_test.timestamp(decoded_block([0.5], missing=lost * (not n)), START_NS + n * MS)
        for n in range(100)
    ]
    assert under_test.behind == 0
    assert blocks[0] is not None
    assert (blocks[0].first_ns, blocks[0].missing) == (START_NS, lost)


def test_a_value_too_large_for_a_frame_is_a_lost_sample_and_no_lost_frame() -> None:
    """Displays refuse a frame with such a value, and with it the samples of all its channels."""
    under_test, framer = timestamper("binary"), Framer(description(batch=5), session=1)
    sent, frames = list[SampleBlock](), list[Frame]()
    for number, force_n in enumerate([-1.01e6, 0.5, 0.5, 1e30, 0.5, 0.5]):
        block = decoded_block([force_n], number * MS, restarted=not number)
        timestamped = under_test.timestamp(block, START_NS + number * MS)
        if timestamped is not None:
            sent.append(timestamped)
            frames += framer.frames(timestamped)
    assert [block.missing for block in sent] == [1, 0, 1, 0]
    assert (under_test.samples, under_test.missing, under_test.too_large) == (4, 2, 2)
    assert under_test.restarts == 0
    decoded = [decode_frame(encode_frame(frame)) for frame in frames]
    assert [frame.first_sample for frame in decoded] == [1, 2, 4, 5]


def test_samples_whose_time_has_passed_are_counted_and_none_before_them_is_forgotten() -> None:
    under_test = timestamper()

    def timestamped(forces_n: list[float], at_ms: int, missing: int = 0) -> SampleBlock | None:
        return under_test.timestamp(decoded_block(forces_n, None, missing), START_NS + at_ms * MS)

    assert timestamped([0.5] * 4, 1000) is not None
    assert timestamped([1e30] * 2, 1002) is None
    assert timestamped([0.5] * 3, 500, missing=5) is None
    assert (under_test.too_large, under_test.behind, under_test.missing) == (2, 3, 0)
    block = timestamped([0.5] * 4, 1014, missing=1)
    assert block is not None
    assert (block.missing, under_test.missing, under_test.samples) == (8, 8, 8)
