"""telepulse's own board for a step and direction carrier, in velocity mode.

A command is one frame, written at once and not waited for: the board sends its state each
millisecond whatever the host does. The drive's thread sends velocity 0 while the loop has not begun
yet, and the withdrawal after a fault (decision 29). A board whose host is gone withdraws the tip by
itself.
"""

import time
from typing import ClassVar

from protocol.faults import Part
from pulse_drives.axis import Axis
from pulse_drives.drive import PERIOD_S, REST_WITHIN_S, Drive, DriveDevice
from pulse_drives.stepdir.board import DisplayBoard
from pulse_drives.stepdir.line import BoardFilm, BoardLine
from pulse_drives.stepdir.scene import StepdirScene
from pulse_drives.supervisor import GIVEN_UP


class StepdirDrive(Drive):
    """A `Drive` over the frames of a display board. counts: those of `BoardLine`."""

    step_s = 5e-3
    part: ClassVar[Part] = Part.BOARD
    _board: DisplayBoard

    def __init__(self, scene: StepdirScene, axis: Axis) -> None:
        super().__init__(scene, axis)
        self._scene = scene
        self._line = BoardLine(scene, self.counts)
        self._film_counts: tuple[float, float] | None = None

    def film_port(self, least_counts: float, most_counts: float) -> BoardFilm:
        """See `Drive.film_port`."""
        self._film_counts = least_counts, most_counts
        return BoardFilm(self._line)

    def _connect(self) -> DriveDevice:
        self._board = DisplayBoard(self._line, self._scene, self._axis, self._film_counts)
        return self._board

    @property
    def _sends_alone(self) -> bool:
        # A board counts its watchdog from homing on, before the loop begins.
        return super()._sends_alone or not self._supervisor.commanded_ns

    def _read_reports(self, now_ns: int) -> None:
        board, supervisor = self._board, self._supervisor
        board.refresh()
        supervisor.check_silence(now_ns, board.silence)
        if board.received_ns > supervisor.position_ns:
            supervisor.add_position(board.position_m, board.received_ns)
        if (fault := board.fault(now_ns)) is not None:
            supervisor.fail(fault)

    def _send(self, now_ns: int) -> None:
        supervisor, board = self._supervisor, self._board
        velocity, withdrawal = supervisor.velocity_to_send(now_ns), supervisor.withdrawal
        if withdrawal is not None and withdrawal.handed_over:
            return
        # A motor that presses while it steps away would press on under its board as well.
        if (
            withdrawal is not None
            and withdrawal.outcome in GIVEN_UP
            and not withdrawal.stopped_by_film
            and board.follows
        ):
            # The board counts its steps by itself; without velocities it withdraws as well.
            board.ask_withdrawal()
            withdrawal.hand_over(now_ns)
        elif board.send_velocity(velocity):
            supervisor.mark_sent(velocity, now_ns)
        else:
            supervisor.mark_unsent(now_ns)

    def _home_switch(self) -> bool | None:
        if self._scene.homing != "switch":
            return None
        asked_ns, deadline_s = time.perf_counter_ns(), time.monotonic() + REST_WITHIN_S
        while self._board.received_ns <= asked_ns and time.monotonic() < deadline_s:
            self.command(0.0)
            time.sleep(PERIOD_S)
        return self._board.closed_switch()
