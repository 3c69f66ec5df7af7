"""The serial line to a display board, which its drive and its film share.

A thread reads the board's states. Commands are written by whoever sends them, and never waited for:
one that the port does not take at once is superseded by the next.
"""

import os
import threading
import time
from collections import Counter, deque
from contextlib import suppress
from itertools import count
from typing import Any, TypeVar

from protocol.errors import DriveError, SourceError
from protocol.faults import Fault, FaultKind, Part, internal_fault
from protocol.host.descriptors import DescriptorSet
from protocol.host.guard import GuardedThread
from pulse_drives.scene import open_port
from pulse_drives.start_advice import start_advice
from pulse_drives.stepdir.frames import (
    COUNTER_TURN,
    SENSOR_FORMATS,
    SEQUENCE_TURN,
    BoardGreeting,
    BoardState,
    CommandAnswer,
    Format,
    board_reader,
    decode_report,
    encode_command,
)
from pulse_drives.stepdir.scene import StepdirScene

READ_BYTES = 4096
WAIT_S = 0.1
WAIT_NS = round(WAIT_S * 1e9)
# The line's thread waits for bytes at most that long, or for pyserial's two reads.
THREAD_ENDS_WITHIN_S = 1.0
POLL_S = 0.002
# A board answers within a few ms; USB may deliver every 16 ms.
ANSWER_WITHIN_S = 0.15
TRIES = 3
# A larger gap in the count of the states is a board that has started anew.
MOST_MISSED = 10_000
MOST_FILM = 10_000
SENSORS_BOARD = "this is a sensor's board, not the display's"
AnswerT = TypeVar("AnswerT", BoardGreeting, CommandAnswer)

FilmReading = tuple[int, int, int]
"""Number and time in µs of a board's millisecond, and the film's counts in it."""


class BoardLine:
    """The port to one board, open while it has users.

    Attributes
    ----------
    state, state_ns
        The board's last state, None before any, and its time of arrival.
    lost, lost_kind
        Reason for which the port cannot be used any more; empty while it can. Kind of its fault.
    error
        An exception of the line's thread that no code expects; None while there is none.
    counts
        Frames of the board that noise has altered ("garbled"), that were left out ("missed") or
        that came twice ("repeated"), frames of ours that the board could not read ("unread"), and
        commands that the port did not take ("superseded").
    """

    def __init__(self, scene: StepdirScene, counts: Counter[str]) -> None:
        self.name, self._baud = scene.port, scene.baud
        self.counts = counts
        self.state: BoardState | None = None
        self.state_ns = self.garbled_ns = 0
        self.lost, self.lost_kind = "not open", FaultKind.UNPLUGGED
        self.error: Fault | None = None
        self._reader = board_reader()
        self.film: deque[FilmReading] = deque(maxlen=MOST_FILM)
        self.film_come = threading.Event()
        self._users = 0
        self._using = threading.Lock()
        self._sequence = count(1)
        self._answers: dict[int, BoardGreeting | CommandAnswer] = {}
        self._answered = threading.Event()
        self._unsent = b""
        self._port: Any = None
        # Of a device or a socket on Linux or macOS; -1 where only pyserial can read and write.
        self._descriptor = -1
        self._readable: DescriptorSet | None = None
        self._thread: GuardedThread | None = None

    def attach(self) -> None:
        """Open the port, unless another user has opened it. Raises DriveError.

        A port that was lost is opened again.
        """
        with self._using:
            if self.lost:
                self._shut()
                self._open()
            self._users += 1

    def detach(self) -> None:
        """Close the port with its last user. Never raises."""
        with self._using:
            self._users -= 1
            if not self._users:
                self._shut()

    def send(self, command: Format, *fields: int) -> int | None:
        """Write a command without waiting; return its sequence, None where it was superseded.

        Raises DriveError of kind "unplugged", or "wrong" where another board is there.
        """
        if self.lost:
            raise DriveError(self.lost_kind, f"{self.name}: {self.lost}")
        sequence = next(self._sequence) % SEQUENCE_TURN
        # An answer to a command of the same number, a turn ago.
        self._answers.pop(sequence, None)
        # The rest of a frame of which the port has taken a part goes first.
        data = self._unsent + encode_command(command, sequence, fields)
        rest = len(self._unsent)
        try:
            written = self._write(data)
        except OSError as error:
            raise DriveError(FaultKind.UNPLUGGED, f"{self.name}: {error}") from None
        if written > rest:
            self._unsent = data[written:]
            return sequence
        self._unsent = self._unsent[written:]
        self.counts["superseded"] += 1
        return None

    def greet(self, within_s: float) -> BoardGreeting:
        """Return the board's greeting, which a bootloader may delay. Raises DriveError."""
        until_s = time.monotonic() + within_s
        while self.state is None and not self.lost and time.monotonic() < until_s:
            time.sleep(POLL_S)
        if self.state is not None:
            # The board may have taken our first numbers from another host.
            self._sequence = count(self.state.sequence + 1)
        while time.monotonic() < until_s:
            sequence = self.send(Format.GREET)
            if (greeting := self._await(sequence, BoardGreeting)) is not None:
                return greeting
        raise DriveError(FaultKind.NO_ANSWER, f"{self.name}: no greeting within {within_s:g} s")

    def request(self, command: Format, *fields: int) -> CommandAnswer | None:
        """Send a command and return its answer; None where its answer is lost, but it was taken.

        Raises DriveError of kind "no answer" where it stays unanswered, or "unplugged".
        """
        for _ in range(TRIES):
            sequence = self.send(command, *fields)
            if (answer := self._await(sequence, CommandAnswer)) is not None:
                return answer
            if self.state is not None and self.state.sequence == sequence:
                return None
        raise DriveError(FaultKind.NO_ANSWER, f"{self.name}: no answer to {command.name.lower()}")

    def _await(self, sequence: int | None, kind: type[AnswerT]) -> AnswerT | None:
        """Return the answer to a command of a sequence; None where none comes in time."""
        until_s = time.monotonic() + ANSWER_WITHIN_S
        while (left_s := until_s - time.monotonic()) > 0:
            answer = self._answers.get(-1 if sequence is None else sequence)
            if isinstance(answer, kind):
                return answer
            self._answered.wait(left_s)
            self._answered.clear()
        return None

    def _open(self) -> None:
        self._port = open_port(self.name, self._baud, WAIT_S, WAIT_S)
        self._descriptor = _descriptor(self._port)
        if self._descriptor >= 0:
            self._readable = DescriptorSet([self._descriptor])
        self.state, self._unsent, self.error = None, b"", None
        self._answers.clear()
        self._reader = board_reader()
        self.lost, self.lost_kind = "", FaultKind.UNPLUGGED
        self._thread = GuardedThread(f"line {self.name}", self._listen, self._on_error)
        try:
            self._thread.start()
        except BaseException:
            self._thread = None
            self._port.close()
            self.lost = "not open"
            raise

    def _shut(self) -> None:
        """Close the port, where it is open."""
        self.lost = self.lost or "closed"
        thread, self._thread = self._thread, None
        if thread is None:
            return
        if not thread.stop(THREAD_ENDS_WITHIN_S):
            self.counts["line hangs"] += 1
        # Closing a port that is gone may fail.
        with suppress(Exception):
            self._port.close()

    def _listen(self) -> None:
        """Read the board's frames that have come; a step of the thread."""
        if self.lost:
            self.film_come.set()
            time.sleep(WAIT_S)
            return
        try:
            data = self._read()
        except Exception as error:  # pyserial passes on errors of many kinds
            self.lost = str(error) or type(error).__name__
            self.film_come.set()
            return
        now_ns, altered = time.perf_counter_ns(), self._reader.altered
        for body in self._reader.feed(data):
            self._take(body, now_ns)
        self._count_garbled(self._reader.altered - altered, now_ns)

    def _on_error(self, error: BaseException) -> None:
        self.counts[f"error: {type(error).__name__}"] += 1
        if self.error is None:
            now_ns = time.perf_counter_ns()
            self.error = internal_fault(Part.BOARD, f"line {self.name}", error, now_ns)

    def _read(self) -> bytes:
        if self._descriptor < 0:
            first: bytes = self._port.read(1)
            return first + bytes(self._port.read(self._port.in_waiting))
        if self._readable is not None and not self._readable.wait(WAIT_NS):
            return b""
        if data := os.read(self._descriptor, READ_BYTES):
            return data
        raise OSError("the device is gone")

    def _write(self, data: bytes) -> int:
        """Return the number of bytes that the port has taken."""
        if self._descriptor < 0:
            return int(self._port.write(data))
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            return 0

    def _take(self, body: bytes, now_ns: int) -> None:
        report = decode_report(body)
        match report:
            case BoardState():
                self._take_state(report, now_ns)
            case None if body[0] >= SENSOR_FORMATS:
                self.lost, self.lost_kind = SENSORS_BOARD, FaultKind.WRONG_DEVICE
            case None:
                self._count_garbled(1, now_ns)
            case _:
                self._answers[report.sequence] = report
                self._answered.set()

    def _take_state(self, state: BoardState, now_ns: int) -> None:
        if (before := self.state) is not None:
            if state.counter == before.counter:
                self.counts["repeated"] += 1
                return
            missed = (state.counter - before.counter - 1) % COUNTER_TURN
            if missed <= MOST_MISSED:
                self.counts["missed"] += missed
                self.counts["unread"] += (state.rejected - before.rejected) % 256
        # The time last: who reads it sees at least this state.
        self.state = state
        self.state_ns = now_ns
        self.film.append((state.counter, state.time_us, state.film))
        self.film_come.set()

    def _count_garbled(self, frames: int, now_ns: int) -> None:
        if frames:
            self.counts["garbled"] += frames
            self.garbled_ns = now_ns


class BoardFilm:
    """The film on a board's line, as a port of a `pulse_sensors.sensor.Sensor`."""

    def __init__(self, line: BoardLine) -> None:
        self._line = line
        self._attached = False
        self.name = f"the film of {line.name}"

    def open(self) -> None:
        """Use the line from now on. Raises SourceError."""
        try:
            self._line.attach()
        except DriveError as error:
            raise SourceError(f"{error}; {start_advice(error)}") from None
        self._attached = True
        self._line.film.clear()

    def read(self) -> list[FilmReading]:
        """Return the readings that have come; none after 0.1 s without any.

        Raises DriveError if the port is gone.
        """
        line = self._line
        line.film_come.clear()
        if not line.film:
            if line.lost:
                raise DriveError(FaultKind.UNPLUGGED, line.lost)
            line.film_come.wait(WAIT_S)
        return [line.film.popleft() for _ in range(len(line.film))]

    def close(self) -> None:
        """Release the line. Never raises."""
        if self._attached:
            self._attached = False
            self._line.detach()


def _descriptor(port: Any) -> int:
    """Return the descriptor of a port that can be read and written without pyserial, else -1."""
    if os.name != "posix":
        return -1
    try:
        number = int(port.fileno())
    except (AttributeError, OSError):  # io.UnsupportedOperation is an OSError
        return -1
    os.set_blocking(number, False)
    return number
