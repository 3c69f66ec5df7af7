import itertools
import re
import threading
from collections import Counter
from collections.abc import Sequence
from contextlib import closing

import pytest

from protocol.config.scene import validate
from protocol.errors import SourceError
from pulse_sensors import sensor as module
from pulse_sensors.binary_frames import FrameDecoder, FrameEncoder
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.samples import DecodedBlock, decoded_block
from pulse_sensors.sensor import Decoder, Sensor
from pulse_sensors.text_lines import TextDecoder
from tests.support.sample_blocks import forces, received
from tests.support.waiting import PATIENCE_S, until

TABLE = validate({"rate": "1 kHz", "unit": "N"}, SensorTable, "scene")


class GivenPort:
    """A port with given values to read, or errors to raise.

    refusals: errors of the openings after the first one, in order; the last one for all further
    openings, unless it is None, which opens.
    """

    name = "the port"

    def __init__(self, *given: object, refusals: Sequence[BaseException | None] = (None,)) -> None:
        self._given = list(given)
        self._refusals = refusals
        self.openings = self.closings = 0
        self.empty = threading.Event()

    def open(self) -> None:
        self.openings += 1
        if self.openings > 1:
            refusal = self._refusals[min(self.openings - 2, len(self._refusals) - 1)]
            if refusal is not None:
                raise refusal

    def read(self) -> object:
        if not self._given:
            self.empty.wait(0.01)
            self.empty.set()
            return None
        given = self._given.pop(0)
        if isinstance(given, BaseException):
            raise given
        return given

    def close(self) -> None:
        self.closings += 1


class AsIs:
    """A decoder that returns each value unchanged."""

    def __init__(self) -> None:
        self.rejected: Counter[str] = Counter()
        self.resets = 0

    def feed(self, data: float) -> list[DecodedBlock]:
        return [decoded_block([data])]

    def reset(self) -> None:
        self.resets += 1


@pytest.fixture(autouse=True)
def reopened_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REOPEN_EVERY_S", 0.001)


class TerminalError(Exception):
    """Like termios.error, which Windows lacks: no OSError."""


# What drivers raise; the last one would end a thread without a word.
ERRORS = (
    OSError("pulled"),
    TypeError("driver"),
    RuntimeError("driver"),
    TerminalError(5, "Input/output error"),
    MemoryError("no memory"),
    SystemExit("driver"),
)


@pytest.mark.parametrize("error", ERRORS)
def test_after_any_driver_error_the_device_is_reopened(
    error: BaseException, logged: list[str]
) -> None:
    port, decoder = GivenPort(0.1, error, 0.2), AsIs()
    with closing(Sensor(port, decoder, TABLE)) as sensor:
        assert forces(received(sensor, 2)) == [0.1, 0.2]
    assert logged == [f"the port has gone: {error}", "the port is back"]
    assert (port.openings, decoder.resets) == (2, 1)


@pytest.mark.parametrize("error", ERRORS)
def test_after_any_driver_error_at_opening_the_device_is_opened_again(
    error: BaseException, logged: list[str]
) -> None:
    port = GivenPort(0.1, OSError("pulled"), 0.2, refusals=[error, error, None])
    with closing(Sensor(port, AsIs(), TABLE)) as sensor:
        assert forces(received(sensor, 2)) == [0.1, 0.2]
        (gone,) = sensor.faults()
    refused = f"the port: cannot be opened: {error}"
    assert logged == ["the port has gone: pulled", refused, "the port is back"]
    assert gone.startswith("the port was gone 1 time, for ")
    assert port.openings == 4


def test_why_a_device_cannot_be_opened_is_named_at_once_and_when_it_changes(
    logged: list[str],
) -> None:
    gone, busy = SourceError("the port: no such device"), SourceError("the port: busy")
    port = GivenPort(OSError("pulled"), refusals=[gone, gone, gone, busy])
    with closing(Sensor(port, AsIs(), TABLE)) as sensor:
        until(lambda: port.openings > 8)
        assert sensor.poll() == []
        was_gone, reason, never = sensor.faults()
        assert never == "no sample came from the port"
        assert was_gone.startswith("the port was gone 1 time, for ")
        assert re.fullmatch(r"the port: busy \(\d+ attempts\)", reason)
    assert logged == ["the port has gone: pulled", str(gone), str(busy)]


def test_a_device_that_opens_and_never_sends_is_not_back(logged: list[str]) -> None:
    pulled = OSError("pulled")
    port = GivenPort(0.1, pulled, pulled, pulled, None)
    with closing(Sensor(port, AsIs(), TABLE)) as sensor:
        until(lambda: port.openings == 4 and port.empty.is_set())
        sensor.poll()
        was_gone, state = sensor.faults()
        assert was_gone.startswith("the port was gone 1 time, for ")
        assert state == "the port is open again, but sends nothing"
    # The same failure three times is one line.
    assert logged == ["the port has gone: pulled"]
    # Before each attempt the port is closed, whatever it has kept.
    assert port.closings == 4


def test_a_device_that_opens_and_cannot_be_read_is_named(logged: list[str]) -> None:
    port = GivenPort(OSError("pulled"), *[OSError("noise")] * 100)
    with closing(Sensor(port, AsIs(), TABLE)) as sensor:
        until(lambda: port.openings > 5)
        sensor.poll()
        assert "the port: opens, but cannot be read: noise" in "; ".join(sensor.faults())
        assert sensor.losses == 1
    assert logged == ["the port has gone: pulled", "the port: opens, but cannot be read: noise"]


def test_a_thread_that_has_no_memory_for_its_own_note_lives(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls = itertools.count()

    def clock() -> int:
        if next(calls) < 3:
            raise MemoryError
        return 0

    with closing(Sensor(GivenPort(OSError("pulled"), 0.1), AsIs(), TABLE, clock)) as sensor:
        assert forces(received(sensor, 1)) == [0.1]


def test_a_device_that_comes_back_with_another_rate_is_named(logged: list[str]) -> None:
    periods_ns = itertools.chain([1_000_000] * 4000, itertools.repeat(2_000_000))
    given = [*range(1, 4001), OSError("pulled"), *range(1, 4001)]
    sensor = Sensor(GivenPort(*given), AsIs(), TABLE, itertools.accumulate(periods_ns).__next__)
    with closing(sensor):
        received(sensor, 7000)
        fault = "the port sends 500 Hz, the scene says 1000 Hz: check its rate"
        assert logged == ["the port has gone: pulled", "the port is back", fault]
        assert sensor.faults()[-1] == fault


def test_a_driver_that_hangs_is_not_waited_for_without_end(
    monkeypatch: pytest.MonkeyPatch, logged: list[str]
) -> None:
    monkeypatch.setattr(module, "CLOSES_WITHIN_S", 0.01)
    released = threading.Event()

    class Hanging(GivenPort):
        def read(self) -> None:
            released.wait()

    port = Hanging()
    sensor = Sensor(port, AsIs(), TABLE)
    sensor.close()
    assert logged == ["the port cannot be closed: its driver hangs"]
    # The driver is still in use.
    assert port.closings == 0
    monkeypatch.setattr(module, "CLOSES_WITHIN_S", PATIENCE_S)
    released.set()
    sensor.close()
    assert port.closings == 1


def test_a_device_that_cannot_be_closed_is_named(logged: list[str]) -> None:
    class Stuck(GivenPort):
        def close(self) -> None:
            raise OSError("stuck")

    Sensor(Stuck(), AsIs(), TABLE).close()
    assert logged == ["the port cannot be closed: stuck"]


def test_data_that_are_not_polled_are_dropped_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_WAITING", 10)
    port = GivenPort(*range(1, 26))
    with closing(Sensor(port, AsIs(), TABLE)) as sensor:
        until(port.empty.is_set)
        assert len(sensor.poll()) == 10
        assert sensor.rejected == {"backlog": 15}
        assert sensor.poll() == []


class Lines(GivenPort):
    """A port at which each read takes a time, and at the end silence."""

    def __init__(self, *given: tuple[float, bytes]) -> None:
        super().__init__(*(data for _, data in given))
        self._waits_s = [wait_s for wait_s, _ in given]
        self.now_s = 0.0

    def read(self) -> object:
        self.now_s += self._waits_s.pop(0) if self._waits_s else 0.1
        return super().read()

    def clock(self) -> int:
        return round(self.now_s * 1e9)


def lines_of(seconds: float, line: bytes) -> list[tuple[float, bytes]]:
    """Return reads of 10 lines a second."""
    return [(0.1, line)] * round(10 * seconds)


def unread(decoder: Decoder, *given: tuple[float, bytes]) -> Sensor:
    """Return a sensor that has read all that is given, and is closed."""
    port = Lines(*given)
    with closing(Sensor(port, decoder, TEN_HZ, port.clock)) as sensor:
        while not port.empty.is_set():
            sensor.poll()
        until(lambda: not sensor.poll() and port.now_s > sum(wait for wait, _ in given) + 3)
    return sensor


TEN_HZ = validate({"rate": "10 Hz", "unit": "N"}, SensorTable, "scene")
WORDS = "the port sends, but no sample can be read: the line 'ready\\t?' has 'ready' where"


def test_data_without_a_sample_are_quoted_once_within_2_s(logged: list[str]) -> None:
    text = TextDecoder(100_000_000, (0,), None)
    sensor = unread(text, *lines_of(1.4, b"ready\t?\n"))
    assert [line.startswith(WORDS) for line in logged] == [True]
    assert sensor.faults()[0] == logged[0]
    # One such line and then silence, as of a board that waits for a key.
    logged.clear()
    unread(TextDecoder(100_000_000, (0,), None), (0.1, b"\n"), (0.1, b"ready\t?\n"))
    assert [line.startswith(WORDS) for line in logged] == [True]


def test_another_cause_is_named_anew_and_none_while_samples_come(logged: list[str]) -> None:
    ready, good = b"ready\t?\n", b"Force: 0.3 N\n"
    kilos, slow = b"Force: 3 kg\n", lines_of(2, b"")
    text = TextDecoder(100_000_000, (0,), None, ("N",))
    sensor = unread(
        text, *lines_of(9, ready), *lines_of(9, kilos), *lines_of(9, good), *slow,
        *lines_of(9, good), *lines_of(9, ready), *lines_of(9, good),
    )  # fmt: skip
    first, second, third = logged
    assert first.startswith(WORDS)
    assert third.startswith(WORDS)
    assert "the line 'Force: 3 kg' is in kg, the scene says unit = \"N\"" in second
    assert not any("can be read" in fault for fault in sensor.faults())


def test_any_decoder_s_data_are_quoted(logged: list[str]) -> None:
    class Deaf(AsIs):
        def feed(self, data: object) -> list[DecodedBlock]:
            self.rejected["crc"] += 1
            return []

    unread(Deaf(), *lines_of(2, b"\x00\xff" * 40))
    (line,) = logged
    start = "the port sends, but no sample can be read: '" + "\\x00\\xff" * 30
    assert line == f"{start}…': frames with a wrong checksum: check the sensor's cable"


def test_text_at_a_reader_of_frames_and_frames_of_another_kind_are_named(
    logged: list[str],
) -> None:
    unread(FrameDecoder(100_000_000), *lines_of(2, b"0.345\r\n"))
    assert logged == [
        "the port sends, but no sample can be read: the bytes '0.345\\r\\n' hold no frame: set"
        ' framing = "text"'
    ]
    logged.clear()
    encoder = FrameEncoder("int16", channels=3)
    frames = [(0.1, encoder.frame([[1, 2, 3]], n * 100_000)) for n in range(20)]
    unread(FrameDecoder(100_000_000), *frames)
    assert "has format 0x31, so 3 values a sample, and the scene 1: set names" in logged[0]


def test_a_wrong_rate_is_logged_once_while_the_sensor_runs(logged: list[str]) -> None:
    arrival_ns = itertools.count(0, 2_000_000)
    with closing(Sensor(GivenPort(*range(1, 3001)), AsIs(), TABLE, arrival_ns.__next__)) as sensor:
        received(sensor, 2000)
        fault = "the port sends 500 Hz, the scene says 1000 Hz: check its rate"
        assert logged == [fault]
        assert sensor.faults()[-1] == fault
