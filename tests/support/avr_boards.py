"""The sketch of the finger's board on a simulated ATmega328P, addressed by frames."""

import socket

from pulse_drives.stepdir.frames import (
    SEQUENCE_TURN,
    BoardGreeting,
    BoardMode,
    BoardState,
    CommandAnswer,
    CommandResult,
    Format,
    board_reader,
    decode_report,
    encode_command,
)
from pulse_drives.stepdir.scene import PER_STEP_RATE
from tests.support.simavr import Harness, Programs


class Display(Harness):
    """The display's board at a finger, and its host; time passes only in `run`.

    Attributes
    ----------
    states, others
        States, and answers and greetings, in the order of their arrival.
    spoilt
        Number of frames that the host cannot read.
    """

    def __init__(self, programs: Programs, *settings: str) -> None:
        self._line, its = socket.socketpair()
        self._line.setblocking(False)
        with its:
            number = its.fileno()
            settings = "clock=0", f"socket={number}", *settings
            super().__init__(programs, *settings, pass_fds=[number])
        self._reader = board_reader()
        self._sequence = 0
        self.states: list[BoardState] = []
        self.others: list[CommandAnswer | BoardGreeting] = []
        self.spoilt = 0

    def close(self) -> None:
        """End board and host."""
        super().close()
        self._line.close()

    def pass_time(self, ms: float) -> None:
        """Let time pass, without a look at the line."""
        self.tell(f"run {ms}")
        assert self.read_line() == "ran"

    def run(self, ms: float) -> BoardState:
        """Let time pass; return the last state."""
        while ms > 0:
            # A socket holds some 200 frames.
            self.pass_time(min(ms, 100))
            ms -= 100
            self._receive()
        return self.states[-1]

    def run_until(
        self, mode: BoardMode, most_ms: int = 5_000, *, alive: bool = False
    ) -> BoardState:
        """Let time pass until the board is in a state; alive: send velocity 0 each 10 ms."""
        for passed_ms in range(most_ms):
            if self.run(1).mode is mode:
                return self.states[-1]
            if alive and passed_ms % 10 == 0:
                self.send(Format.VELOCITY, 0, 20)
        raise AssertionError(f"not in state {mode.name} but {self.states[-1]}")

    def send(self, command: Format, *fields: int) -> int:
        """Send a command; return its sequence number."""
        self._sequence = (self._sequence + 1) % SEQUENCE_TURN
        self.write(encode_command(command, self._sequence, fields))
        return self._sequence

    def write(self, data: bytes) -> None:
        """Send bytes."""
        self._line.sendall(data)

    def ask(self, command: Format, *fields: int) -> tuple[CommandResult, int]:
        """Send a command, and return the answer's result and field."""
        sequence, known = self.send(command, *fields), len(self.others)
        self.run(5)
        (answer,) = self.others[known:]
        assert isinstance(answer, CommandAnswer)
        assert answer[:2] == (sequence, command)
        return answer.result, answer.field

    def greet(self) -> BoardGreeting:
        """Return the answer to a greeting."""
        sequence = self.send(Format.GREET)
        self.run(5)
        greeting = self.others[-1]
        assert isinstance(greeting, BoardGreeting)
        assert greeting.sequence == sequence
        return greeting

    def drive(self, steps_per_s: float, ms: int, validity_ms: int = 20) -> BoardState:
        """Send a velocity each 2 ms for a time."""
        for _ in range(0, ms, 2):
            self.send(Format.VELOCITY, round(steps_per_s * PER_STEP_RATE), validity_ms)
            self.run(2)
        return self.states[-1]

    def _receive(self) -> None:
        try:
            data = self._line.recv(1 << 20)
        except BlockingIOError:
            return
        altered = self._reader.altered
        for report in map(decode_report, self._reader.feed(data)):
            match report:
                case BoardState():
                    self.states.append(report)
                case None:
                    self.spoilt += 1
                case _:
                    self.others.append(report)
        self.spoilt += self._reader.altered - altered
