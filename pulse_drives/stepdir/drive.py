"""telepulse's own board for a step and direction carrier, in velocity mode.

A command is one frame, written at once and not waited for: the board sends its state each
millisecond whatever the host does. The drive's thread sends velocity 0 while the loop has not begun
yet, and the withdrawal after a fault (decision 29). A board whose host is gone withdraws the tip by
itself.
"""

import time

from protocol.errors import DriveError
from pulse_drives.axis import Axis
from pulse_drives.drive import PERIOD_S, REST_WITHIN_S, Drive, DriveDevice
from pulse_drives.stepdir.board import DisplayBoard
from pulse_drives.stepdir.line import BoardFilm, BoardLine
from pulse_drives.stepdir.scene import StepdirScene


class StepdirDrive(Drive):
    """A `Drive` over the frames of a display board. counts: those of `BoardLine`."""

    step_s = 5e-3
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

    def _step(self) -> None:
        with self._lock.acquire_or_proceed():
            now_ns = time.perf_counter_ns()
            self._read_reports(now_ns)
            supervisor = self._supervisor
            if supervisor.fault is not None or not supervisor.commanded_ns:
                self._send(now_ns)

    def _read_reports(self, now_ns: int) -> None:
        board, supervisor = self._board, self._supervisor
        board.refresh()
        supervisor.check_silence(now_ns, board.silence)
        if board.received_ns > supervisor.position_ns:
            supervisor.add_position(board.position_m, board.received_ns)
        if trouble := board.lost or board.trouble:
            supervisor.fail(trouble, now_ns)

    def _send(self, now_ns: int) -> None:
        supervisor = self._supervisor
        velocity = supervisor.velocity_to_send(now_ns)
        try:
            if self._board.send_velocity(velocity):
                supervisor.mark_sent(velocity, now_ns)
            else:
                supervisor.mark_unsent(now_ns)
        except DriveError as error:
            supervisor.mark_unsent(now_ns)
            supervisor.fail(f"{error.kind}: {error}", now_ns)

    def _home_switch(self) -> bool | None:
        if self._scene.homing != "switch":
            return None
        asked_ns, deadline_s = time.perf_counter_ns(), time.monotonic() + REST_WITHIN_S
        while self._board.received_ns <= asked_ns and time.monotonic() < deadline_s:
            self.command(0.0)
            time.sleep(PERIOD_S)
        return self._board.closed_switch()
