"""An emulated display board, byte for byte, on a pseudo-terminal.

The board itself is pure: time is an argument, and it returns the frames that the firmware would
send. Its states, bounds, trips and withdrawals are those of `firmware/PROTOCOL.md`. Not modelled:
the microcontroller's timing; the end without a ramp of a motion towards the finger that a
withdrawal interrupts; and a stall that no fault pin reports: the count of steps then stops as well.
"""

import math
import select
import time
from collections.abc import Callable
from random import Random

from pulse_drives.stepdir.frames import (
    COUNTER_TURN,
    BoardCommand,
    BoardGreeting,
    BoardLimits,
    BoardMode,
    BoardState,
    CommandAnswer,
    CommandResult,
    Format,
    HomeSearch,
    LimitOption,
    StateFlag,
    TripCause,
    board_reader,
    decode_command,
    encode_report,
)
from pulse_drives.stepdir.scene import PER_STEP_RATE
from pulse_sensors.drive_film import DriveFilmScene
from telepulse.emulators import PtyPort
from telepulse.emulators.motor import TICK_NS, EmulatedMotor

PROTOCOL = 1
FIRMWARE = (1 << 8) + 1
TICK_HZ = 32_000
# 16 conversions of 10 bits in a millisecond.
FULL_SCALE = 16 * 1023
FURTHEST = 1 << 30
POWER_UP, RESET_PIN = 1, 2
# The motor leaves the home switch at this share of the search's rate.
LEAVE_SHARE = 1 / 8
# The film of a board whose scene describes none.
NO_FILM = 8184
NOISE_SEED = 1
MOTIONS = (BoardMode.READY, BoardMode.RUNNING)
TRIPS = (BoardMode.HOMING, *MOTIONS)


class EmulatedBoard:
    """A board with its motor.

    film: the scene's table, which gives the counts of a force; noise_n: RMS of its noise.

    Attributes
    ----------
    tick_hz, protocol, firmware
        As the board states them in its greeting.
    limits
        The limits that it was given; None before any.
    trouble
        "silent" where it sends nothing, "garbled" where it sends wrong bytes, else "".
    """

    _mode: BoardMode
    _homed: bool

    def __init__(
        self,
        motor: EmulatedMotor,
        film: DriveFilmScene | None,
        now_ns: int,
        noise_n: float = 0.0,
    ) -> None:
        self._motor, self._film = motor, film
        self._noise_n, self._noise = noise_n, Random(NOISE_SEED)
        self._now_ns = now_ns
        self._frames: list[bytes] = []
        self._on_line: list[bytes] = []
        self._force_n, self._read_n = motor.force_n, motor.force_n
        self._reader = board_reader()
        self.protocol, self.firmware, self.tick_hz = PROTOCOL, FIRMWARE, TICK_HZ
        self.trouble = ""
        self.limits: BoardLimits | None = None
        self._start(POWER_UP)

    @property
    def mode(self) -> BoardMode:
        """State of the board's state machine."""
        return self._mode

    def reset(self) -> None:
        """Restart, as by its reset pin: a tip that may press is taken off the finger."""
        pressing = self._homed and self._mode is not BoardMode.WITHDRAWN
        limits = self.limits
        self._switch_off(BoardMode.DISARMED, TripCause.NONE)
        self._start(RESET_PIN)
        if pressing and limits is not None:
            self.limits = limits
            self._mode = BoardMode.ARMED
            self._withdraw(TripCause.RESET)

    def receive(self, data: bytes, now_ns: int) -> None:
        """Take bytes from the host at a time, and execute the commands that they complete."""
        self.advance(now_ns)
        for body in self._reader.feed(data):
            command = decode_command(body)
            if command is not None:
                self._execute(command)

    def advance(self, now_ns: int) -> None:
        """Advance to the present, a millisecond at a time."""
        while self._now_ns + TICK_NS <= now_ns:
            self._now_ns += TICK_NS
            self._motor.advance(self._now_ns)
            self._tick()
        self._motor.advance(now_ns)

    def due_frames(self) -> list[bytes]:
        """Return the frames to send since the last call."""
        frames, self._frames = self._frames, []
        match self.trouble:
            case "silent":
                return []
            case "garbled":
                return [bytes([frame[0] ^ 0x55, *frame[1:]]) for frame in frames]
        return frames

    @property
    def _is_on(self) -> bool:
        return self._mode not in (BoardMode.DISARMED, BoardMode.FAULT)

    @property
    def _film_counts(self) -> int:
        if self._film is None:
            return NO_FILM
        counts = self._film.zero + (self._read_n - self._film.preload_n) / self._per_count
        return min(max(round(counts), 0), FULL_SCALE)

    @property
    def _per_count(self) -> float:
        return 1.0 if self._film is None else self._film.newtons_per_count or 1.0

    def _start(self, reset_cause: int) -> None:
        self._reset_cause = reset_cause
        self._on_line.clear()
        self._counter = self._sequence = self._rejected = 0
        self._mode, self._cause = BoardMode.DISARMED, TripCause.NONE
        self.limits = None
        self._search = HomeSearch(0, 0, 1, 1)
        self._began_steps = self._target_steps = 0
        self._homed = self._expired = False
        self._wanted_hz = 0.0
        self._began_ms = self._commanded_ms = self._validity_ms = 0
        self._motor.limit(-math.inf, math.inf)
        self._motor.zero()

    def _execute(self, command: BoardCommand) -> None:
        match command.format:
            case Format.VELOCITY:
                self._take_velocity(command)
                return
            case Format.GREET:
                self._sequence = command.sequence
                version = self.protocol, self.firmware, self.tick_hz
                head = command.sequence, *version, FULL_SCALE, self._reset_cause
                self._send(BoardGreeting(*head, "emulated"))
                return
            case Format.HOME:
                result, field = self._home(HomeSearch(*command.fields))
            case Format.LIMITS:
                result, field = self._take_limits(BoardLimits(*command.fields))
            case _:
                result, field = self._change(command.format), 0
        if result is CommandResult.DONE:
            self._sequence = command.sequence
        self._send(CommandAnswer(command.sequence, command.format, result, field))

    def _take_velocity(self, command: BoardCommand) -> None:
        velocity, validity_ms = command.fields
        if self._mode not in MOTIONS or self.limits is None or not 1 <= validity_ms <= 1000:
            return
        most = self.limits.highest_rate
        self._wanted_hz = min(max(velocity / PER_STEP_RATE, -most), most)
        self._mode, self._expired = BoardMode.RUNNING, False
        self._sequence, self._validity_ms = command.sequence, validity_ms
        self._commanded_ms = self._counter

    def _change(self, command: Format) -> CommandResult:
        """Execute a command without fields."""
        match command:
            case Format.ARM if self.limits is None:
                return CommandResult.NO_LIMITS
            case Format.ARM if self._mode is BoardMode.DISARMED:
                self._mode = BoardMode.ARMED
            case Format.DISARM:
                self._switch_off(BoardMode.DISARMED, TripCause.NONE)
            case Format.CLEAR if self._mode in (BoardMode.WITHDRAWN, BoardMode.FAULT):
                self._switch_off(BoardMode.DISARMED, TripCause.NONE)
            case Format.WITHDRAW if self._mode in (BoardMode.ARMED, *TRIPS):
                self._withdraw(TripCause.HOST)
            case _:
                return CommandResult.WRONG_STATE
        return CommandResult.DONE

    def _take_limits(self, limits: BoardLimits) -> tuple[CommandResult, int]:
        if self._mode is not BoardMode.DISARMED:
            return CommandResult.WRONG_STATE, 0
        bounds = (
            (-FURTHEST, FURTHEST),
            (limits.lowest + 1, FURTHEST),
            (1_000, 100_000_000),
            (10, self.tick_hz),
            (0, limits.film_most - 1),
            (0, FULL_SCALE + 1),
            (1, FURTHEST),
            (10, limits.highest_rate),
            (10, 500),
            (0, 31),
        )
        if wrong := _wrong_field(limits, bounds):
            return CommandResult.OUT_OF_BOUNDS, wrong
        self.limits = limits
        return CommandResult.DONE, 0

    def _home(self, search: HomeSearch) -> tuple[CommandResult, int]:
        limits = self.limits
        if self._mode not in (BoardMode.ARMED, *MOTIONS) or limits is None:
            return CommandResult.WRONG_STATE, 0
        least_rate = 10 if search.rate else 0
        bounds = ((least_rate, limits.highest_rate), (0, FURTHEST), (1, FURTHEST), (1, 60_000))
        if wrong := _wrong_field(search, bounds):
            return CommandResult.OUT_OF_BOUNDS, wrong
        if self._film_outside:
            return CommandResult.FILM_OUTSIDE, 0
        self._search = search
        self._began_steps, self._began_ms = self._motor.position_steps, self._counter
        if search.rate:
            self._homed, self._mode = False, BoardMode.HOMING
            self._motor.limit(-math.inf, math.inf)
            self._motor.home(search.rate, max(10.0, LEAVE_SHARE * search.rate))
        else:
            self._motor.run(0.0)
            self._motor.zero()
            self._be_home(limits)
        return CommandResult.DONE, 0

    def _be_home(self, limits: BoardLimits) -> None:
        self._homed, self._mode = True, BoardMode.READY
        self._motor.limit(limits.lowest, limits.highest)

    def _switch_off(self, mode: BoardMode, cause: TripCause) -> None:
        self._motor.run(0.0)
        self._homed = False
        self._mode, self._cause = mode, cause

    def _withdraw(self, cause: TripCause) -> None:
        assert self.limits is not None
        limits, position = self.limits, self._motor.position_steps
        target = position - limits.withdrawal
        if self._homed:
            target = max(target, min(limits.lowest, position))
        if self._mode is BoardMode.HOMING:
            target = self._began_steps
        self._target_steps = target
        self._mode, self._cause = BoardMode.WITHDRAWING, cause

    def _tick(self) -> None:
        """Supervise, move on and send the state of a millisecond."""
        self._counter = (self._counter + 1) % COUNTER_TURN
        forces_n = self._motor.forces_n
        force_n = forces_n[-1] if forces_n else self._motor.force_n
        # A reading is the mean over the millisecond.
        self._read_n = (self._force_n + force_n) / 2 + self._noise.gauss(0.0, self._noise_n)
        self._force_n = force_n
        self._supervise()
        match self._mode:
            case BoardMode.RUNNING:
                self._motor.run(self._wanted_hz)
            case BoardMode.HOMING:
                self._seek_home()
            case BoardMode.WITHDRAWING:
                self._withdraw_on()
        # A state takes 0.6 ms on the line, at 500 000 baud.
        self._frames += self._on_line
        self._on_line.clear()
        self._send(self._state())

    @property
    def _film_outside(self) -> bool:
        limits = self.limits
        if limits is None:
            return False
        return not limits.film_least <= self._film_counts < limits.film_most

    @property
    def _faulty(self) -> bool:
        """True while the carrier's fault pin is active."""
        has_pin = self.limits is not None and self.limits.options & LimitOption.HAS_FAULT_PIN
        return bool(has_pin) and self._motor.fault in ("overtemperature", "stall")

    def _supervise(self) -> None:
        if self._mode not in TRIPS or self.limits is None:
            return
        silent_ms = self._counter - self._commanded_ms
        if self._film_outside:
            self._withdraw(TripCause.FILM)
        elif self._faulty:
            self._withdraw(TripCause.FAULT_PIN)
        elif self._mode is not BoardMode.RUNNING:
            return
        elif silent_ms > self.limits.watchdog_ms:
            self._withdraw(TripCause.SILENCE)
        elif self._motor.at_switch and self._motor.position_steps > self._search.opening:
            self._withdraw(TripCause.HOME_SWITCH)
        elif silent_ms > self._validity_ms and not self._expired:
            self._expired, self._wanted_hz = True, 0.0

    def _seek_home(self) -> None:
        travelled = abs(self._motor.position_steps - self._began_steps)
        if not self._motor.homing:
            assert self.limits is not None
            self._be_home(self.limits)
        elif self._counter - self._began_ms > self._search.timeout_ms:
            self._switch_off(BoardMode.FAULT, TripCause.HOMING_TIMEOUT)
        elif travelled > self._search.distance and not self._motor.at_switch:
            self._switch_off(BoardMode.FAULT, TripCause.NO_HOME)

    def _withdraw_on(self) -> None:
        assert self.limits is not None
        left = self._target_steps - self._motor.position_steps
        rate_hz = self.limits.withdrawal_rate
        # A rate that a ramp reaches late must not lead beyond the target, and back, without end.
        bounded_hz = min(rate_hz, abs(left) * 0.5e9 / TICK_NS)
        arrived = not left or (left < 0 and self._motor.at_switch)
        self._motor.run(0.0 if arrived else math.copysign(bounded_hz, left))
        if arrived and not self._motor.rate_hz:
            self._mode = BoardMode.WITHDRAWN

    def _state(self) -> BoardState:
        motor, limits = self._motor, self.limits
        position = motor.position_steps
        flags = {
            StateFlag.HOMED: self._homed,
            StateFlag.HOME_CLOSED: motor.at_switch,
            StateFlag.AT_LOWEST: self._homed and limits and position <= limits.lowest,
            StateFlag.AT_HIGHEST: self._homed and limits and position >= limits.highest,
            StateFlag.FAULT_PIN: self._faulty,
            StateFlag.FILM_OUTSIDE: self._film_outside,
            StateFlag.HAS_LIMITS: limits is not None,
            StateFlag.ON: self._is_on,
            StateFlag.EXPIRED: self._mode is BoardMode.RUNNING and self._expired,
        }
        return BoardState(
            counter=self._counter,
            time_us=self._counter * 1_000 % COUNTER_TURN,
            film=self._film_counts,
            position=position,
            velocity=round(motor.counter_hz * PER_STEP_RATE),
            mode=self._mode,
            cause=self._cause,
            flags=StateFlag(sum(flag for flag, is_set in flags.items() if is_set)),
            sequence=self._sequence,
            rejected=self._reader.altered % 256,
        )

    def _send(self, report: BoardState | BoardGreeting | CommandAnswer) -> None:
        self._on_line.append(encode_report(report))


def _wrong_field(values: tuple[int, ...], bounds: tuple[tuple[float, float], ...]) -> int:
    """Return the number, from 1, of the first value that is out of its bounds; 0 if none is."""
    pairs = enumerate(zip(values, bounds, strict=True), 1)
    return next((n for n, (value, (low, high)) in pairs if not low <= value <= high), 0)


def serve_board(board: EmulatedBoard, port: PtyPort) -> Callable[[float], None]:
    """Return a function that takes what comes within a time in s, and sends what is due."""

    def serve(wait_s: float) -> None:
        readable, _, _ = select.select([port], [], [], wait_s)
        data = port.read() if readable else b""
        board.receive(data, time.perf_counter_ns())
        for frame in board.due_frames():
            port.write(frame)

    return serve
