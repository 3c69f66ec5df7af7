"""From a board's bytes to times on the host, in virtual time: the board knows what is true."""

from collections import Counter
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from protocol.config.scene import validate
from pulse_sensors.reading import Packet, Reading, Readings
from pulse_sensors.serial_port import SerialScene
from telepulse.emulators.sensor_board import BoardBehaviour, SensorBoard, binary, line, timed_line
from tests.support.streams import synthetic

START_NS = 10**15
SECOND_NS = 1_000_000_000
KEYS = {"kind": "serial", "port": "none", "rate": "1 kHz", "unit": "N"}
SCENES = {
    "binary": KEYS | {"framing": "binary"},
    "text": KEYS | {"framing": "text", "device_time": "us"},
    "untimed": KEYS | {"framing": "text"},
}


class Heard(NamedTuple):
    """A board's bytes as a host reads them; off_ms: each reading's time less the true one."""

    board: SensorBoard
    readings: Readings
    rejected: Counter[str]
    placed: list[Reading]
    arrivals_ns: list[int]

    @property
    def numbers(self) -> list[int]:
        """The number of each reading's first sample, as the readings count."""
        counts = [0]
        for reading in self.placed:
            counts.append(counts[-1] + reading.missing + len(reading.force_n))
        return [
            end - len(reading.force_n) for end, reading in zip(counts[1:], self.placed, strict=True)
        ]

    def off_ms(self, after_s: float) -> NDArray[np.float64]:
        """Each reading's time less the true one, from then on."""
        true_ns = np.array([self.board.taken_ns(number) for number in self.numbers])
        said_ns = np.array([reading.first_ns for reading in self.placed])
        off_ms: NDArray[np.float64] = (said_ns - true_ns) * 1e-6
        return off_ms[true_ns > START_NS + after_s * 1e9]


def hear(kind: str, seconds: float, lost: range = range(0), **habits: float) -> Heard:
    """Listen to a board; of its deliveries, those in `lost` never come."""
    encode = {"binary": binary("float32"), "text": timed_line, "untimed": line}[kind]
    frame = 4 if kind == "binary" else 1
    given = BoardBehaviour(frame, **habits)  # type: ignore[arg-type]
    board = SensorBoard(synthetic(), encode, given, START_NS)
    scene = validate(SCENES[kind], SerialScene, "scene")
    heard = Heard(board, Readings(scene), Counter(), [], [])
    decoder = scene.decoder()
    decoder.feed(b"\0" if kind == "binary" else b"\n")
    delivery = 0
    while (now_ns := board.next_delivery_ns) < START_NS + seconds * SECOND_NS:
        data = board.deliver(now_ns)
        for packet in decoder.feed(data) if delivery not in lost else ():
            reading = heard.readings.of(packet, now_ns)
            assert reading is not None
            heard.placed.append(reading)
            heard.arrivals_ns.append(now_ns)
        delivery += 1
    return heard._replace(rejected=decoder.rejected)


@pytest.mark.parametrize("kind", list(SCENES))
@pytest.mark.parametrize("skew", [50e-6, -200e-6, 3e-3])
def test_usb_batches_do_not_jitter_the_times(kind: str, skew: float) -> None:
    heard = hear(kind, 20, skew=skew)
    off_ms = heard.off_ms(after_s=5)
    raw_ms = np.diff(heard.arrivals_ns) * 1e-6
    assert raw_ms.max() > 14
    assert off_ms.std() < 0.1
    assert abs(off_ms).max() < 0.8
    assert heard.readings.missing == 0
    assert sum(len(reading.force_n) for reading in heard.placed) == heard.board.sampled
    if kind != "untimed":
        assert heard.readings.skew_ppm == pytest.approx(skew * 1e6, abs=5)


def test_before_the_clock_is_known_times_are_within_one_delivery() -> None:
    assert abs(hear("binary", 1, skew=50e-6).off_ms(after_s=0)).max() < 16


@pytest.mark.parametrize("kind", list(SCENES))
def test_forces_come_as_they_were_sent(kind: str) -> None:
    heard = hear(kind, 1)
    force_n = [value for reading in heard.placed for value in reading.force_n]
    assert force_n == pytest.approx(synthetic().take(len(force_n))[:, 0].tolist(), abs=1e-6)


@pytest.mark.parametrize("kind", ["binary", "text"])
@pytest.mark.parametrize("lost", [range(300, 301), range(300, 310), range(300, 500)])
def test_what_a_line_loses_is_known_to_be_missing(kind: str, lost: range) -> None:
    heard = hear(kind, 10, lost=lost)
    assert heard.readings.missing > 0
    came = sum(len(reading.force_n) for reading in heard.placed)
    # Text confirms a jump of the time by the line that follows; no count stands in text.
    assert came + heard.readings.missing == pytest.approx(heard.board.sampled, abs=1)
    assert abs(heard.off_ms(after_s=5)).max() < 1.5


@pytest.mark.parametrize("noise", [1e-4, 1e-2])
def test_noise_on_the_line_costs_samples_and_not_the_account(noise: float) -> None:
    heard = hear("binary", 20, noise=noise)
    came = sum(len(reading.force_n) for reading in heard.placed)
    assert 0 < heard.readings.missing < 0.6 * heard.board.sampled
    assert abs(came + heard.readings.missing - heard.board.sampled) <= 8 * 4
    assert sum(heard.rejected.values()) > 0
    assert heard.off_ms(after_s=5).std() < 0.5
    assert heard.readings.restarts == 0


def test_a_board_that_begins_anew_is_followed_and_named() -> None:
    readings = Readings(validate(SCENES["binary"], SerialScene, "scene"))
    for first_s, device_s in ((0, 900), (3, 0)):
        for ms in range(2000):
            device_ns = device_s * SECOND_NS + ms * 1_000_000
            packet = Packet((0.5,), device_ns, anew=ms == 0)
            arrival_ns = START_NS + first_s * SECOND_NS + ms * 1_000_000
            reading = readings.of(packet, arrival_ns)
            assert reading is not None
            assert abs(reading.first_ns - arrival_ns) < 1_000_000
    assert (readings.samples, readings.missing, readings.restarts) == (4000, 1000, 1)
    assert readings.faults("the board") == [
        "1000 samples missing from the board",
        "the board began its clock anew 1 time",
    ]


def test_a_device_cannot_send_what_it_has_not_taken_yet() -> None:
    readings = Readings(validate(SCENES["binary"], SerialScene, "scene"))
    for ms in range(100):
        readings.of(Packet((0.5,), ms * 1_000_000, anew=ms == 0), START_NS + ms * 1_000_000)
    ahead = readings.of(Packet((0.5,), 9 * SECOND_NS), START_NS + 100 * 1_000_000)
    assert ahead is not None
    assert ahead.first_ns == pytest.approx(START_NS + 100 * 1_000_000, abs=1_000_000)


def test_what_lies_behind_is_refused_and_counted() -> None:
    readings = Readings(validate(SCENES["untimed"], SerialScene, "scene"))
    assert readings.of(Packet((0.5,)), START_NS) is not None
    assert readings.of(Packet((0.5,)), START_NS - SECOND_NS) is None
    assert readings.behind == 1


@pytest.mark.parametrize("hz", [800, 1000])
def test_a_rate_that_is_not_the_scenes_is_named_once_it_lasts(hz: int) -> None:
    readings = Readings(validate(SCENES["untimed"], SerialScene, "scene"))
    named = 0
    for number in range(5000):
        readings.of(Packet((0.5,)), START_NS + number * SECOND_NS // hz)
        if readings.lasting_rate_fault("the board") is None:
            assert named == 0
        else:
            named += 1
    said = "the board sends 800 Hz, the scene says 1000 Hz: check its rate"
    assert readings.faults("the board") == ([said] if hz == 800 else [])
    assert readings.lasting_rate_fault("the board") == (said if hz == 800 else None)
    assert named == 0 if hz == 1000 else 1000 < named < 3000


def test_a_sensor_that_never_spoke_is_named() -> None:
    readings = Readings(validate(SCENES["text"], SerialScene, "scene"))
    assert readings.faults("the board") == ["no sample came from the board"]
