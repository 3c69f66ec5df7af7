"""A display board: its version, its limits, homing, velocities and reports; see `DriveDevice`."""

import math
import time
from collections.abc import Callable

from protocol.errors import DriveError
from protocol.faults import Fault, FaultKind, Part
from pulse_drives.axis import Axis
from pulse_drives.drive import ADVICE, OPENED_M, bound_search
from pulse_drives.stepdir.frames import (
    BoardGreeting,
    BoardLimits,
    BoardMode,
    BoardState,
    CommandResult,
    Format,
    HomeSearch,
    LimitOption,
    StateFlag,
    TripCause,
)
from pulse_drives.stepdir.line import BoardLine
from pulse_drives.stepdir.scene import StepdirScene
from pulse_drives.supervisor import NO_ANSWER, Silence
from pulse_drives.withdrawal import FAST_M_PER_S

PROTOCOL = 1
LEAST_FIRMWARE = (1 << 8) + 1
UPDATE = (
    "arduino-cli compile --upload --fqbn arduino:avr:uno --port {port} firmware/telepulse_display"
)
# Opening the port resets many boards, and a bootloader waits up to 2 s before it starts them.
GREETED_WITHIN_S = 4.0
REPORTED_WITHIN_S = 0.5
# A withdrawal of the board itself, beyond the time at its rate: a ramp, and USB.
WITHDRAWAL_MARGIN_S = 2.0
POLL_S = 0.002
# The board gives up a search somewhat later than the host. It takes no search beyond twice the
# travel, and none whose switch opens beyond half of it.
SEARCH_SHARE = 1.2
MOST_SEARCH_SHARE = 2.0
LONGEST_SEARCH_MS = 60_000

TROUBLES = {
    TripCause.NONE: "it has started anew",
    TripCause.SILENCE: "no velocity came in time",
    TripCause.FILM: "the film is beyond its hard limits",
    TripCause.FAULT_PIN: "overtemperature, short circuit or stall, by the carrier's fault pin",
    TripCause.HOST: "it was withdrawn",
    TripCause.RESET: "it was reset",
    TripCause.HOME_SWITCH: "the home switch closed away from home: steps are lost, or it is stuck",
    TripCause.NO_HOME: "no home switch",
    TripCause.STUCK_SWITCH: "the home switch stays closed",
    TripCause.HOMING_TIMEOUT: "the search takes too long",
    TripCause.PRESSED: "the force rises",
}
# Causes that are no fault of carrier or motor.
KINDS = {
    TripCause.NONE: FaultKind.LEFT_STATE,
    TripCause.SILENCE: FaultKind.NO_COMMAND,
    TripCause.FILM: FaultKind.OVERFORCE,
    TripCause.HOST: FaultKind.LEFT_STATE,
}
GARBLED: Silence = (FaultKind.GARBLED, "garbled")


class DisplayBoard:
    """A board on its line; see `DriveDevice`.

    Attributes
    ----------
    state, received_ns
        The state that was last read from the line, and its time of arrival.
    """

    def __init__(
        self,
        line: BoardLine,
        scene: StepdirScene,
        axis: Axis,
        film_counts: tuple[float, float] | None,
    ) -> None:
        """Open the line. Raises DriveError.

        film_counts: hard limits of the film, if any: where it is pulled, and where it is pressed.
        """
        self._line, self._scene, self._axis = line, scene, axis
        self._film_counts = film_counts
        # A copy: attributes of a scene take longer to read.
        self._validity_ms = scene.validity_ms
        self.position_m, self.speed_m_per_s = axis.lowest_m, 0.0
        self.state: BoardState | None = None
        self.received_ns = 0
        line.attach()

    def fault(self, now_ns: int) -> Fault | None:
        """Return why the board cannot be used, or takes no velocities; None where it takes them."""
        line, state = self._line, self.state
        if line.lost:
            return Fault(line.lost_kind, Part.BOARD, f"{line.name}: {line.lost}", now_ns)
        if line.error is not None or state is None or state.mode.follows:
            return line.error
        kind = KINDS.get(state.cause, FaultKind.DRIVE_FAULT)
        return Fault(kind, Part.BOARD, TROUBLES[state.cause], now_ns)

    @property
    def silence(self) -> Silence:
        """Fault to report when no state has arrived for too long."""
        return GARBLED if self._line.garbled_ns > self.received_ns else NO_ANSWER

    def refresh(self) -> None:
        """Take the newest state from the line."""
        received_ns, state = self._line.state_ns, self._line.state
        if state is None or received_ns <= self.received_ns:
            return
        units = self._axis.units
        self.state, self.received_ns = state, received_ns
        self.position_m = units.position_m(state.position)
        self.speed_m_per_s = units.speed_m_per_s(state.velocity)

    def configure(self) -> None:
        """See `DriveDevice.configure`: check the version, set the limits, switch the motor on."""
        greeting = self._line.greet(GREETED_WITHIN_S)
        self._check(greeting)
        # One that was reset, or whose host has ended, takes the tip off the finger first.
        self._disarm()
        self._ask(Format.LIMITS, *self._limits(greeting.film_full_scale))
        self._ask(Format.ARM)
        self._await_report()

    def home(self, guard: Callable[[], None]) -> None:
        """See `DriveDevice.home`. Velocity 0 shows the board that its host is there."""
        axis, began_m = self._axis, self.position_m
        self._ask(Format.HOME, *self._search())
        state = self._await_report(self._show_life)
        while not (state.mode.follows and state.flags & StateFlag.HOMED):
            guard()
            if state.mode is not BoardMode.HOMING:
                raise self._unhomed(state)
            bound_search(axis, began_m, self.position_m)
            state = self._await_report(self._show_life)

    def end_search(self) -> None:
        """End the search for home. The board goes back to where it began if the film shows a press.

        The board then takes no velocities.
        """
        if self.state is not None and self.state.mode is BoardMode.HOMING:
            self._ask(Format.WITHDRAW)
        self._await_mode(lambda mode: mode is not BoardMode.WITHDRAWING)

    def arm_watchdog(self) -> None:
        """Show the board, whose watchdog counts from `home` on, that its host is there."""
        self._show_life()

    def send_velocity(self, velocity: int) -> bool:
        """Send a velocity in 1/256 step/s; return False where it was superseded.

        Raises DriveError of kind `UNPLUGGED`.
        """
        return self._line.send(Format.VELOCITY, velocity, self._validity_ms) is not None

    def ask_withdrawal(self) -> None:
        """Send the command to withdraw without waiting; a board that misses it hears no velocity.

        Raises DriveError of kind `UNPLUGGED`.
        """
        self._line.send(Format.WITHDRAW)

    @property
    def follows(self) -> bool:
        """True where the board takes velocities, by its last state."""
        return self.state is not None and self.state.mode.follows

    def closed_switch(self) -> bool:
        """Return whether the home switch is closed, by the last state."""
        return self.state is not None and StateFlag.HOME_CLOSED in self.state.flags

    def close(self) -> None:
        """See `DriveDevice.close`: the board goes home, and switches its motor off.

        One that cannot be reached withdraws the tip by itself.
        """
        try:
            self._disarm()
        except DriveError as error:
            self._line.counts[f"not disarmed: {error.kind}"] += 1
        self._line.detach()

    def _check(self, greeting: BoardGreeting) -> None:
        """Check the version of the board's program and its step rate. Raises DriveError."""
        name, version = self._line.name, f"{greeting.firmware >> 8}.{greeting.firmware & 0xFF}"
        if greeting.protocol != PROTOCOL or greeting.firmware < LEAST_FIRMWARE:
            old = greeting.protocol < PROTOCOL or greeting.firmware < LEAST_FIRMWARE
            advice = (
                f"update it: {UPDATE.format(port=name)}"
                if old
                else "update telepulse, or load the board's program that comes with this one"
            )
            raise DriveError(
                FaultKind.REFUSED,
                f"{name}: the firmware {version} has protocol {greeting.protocol}, and protocol"
                f" {PROTOCOL} of firmware {LEAST_FIRMWARE >> 8}.{LEAST_FIRMWARE & 0xFF} is needed;"
                f" {advice}",
            )
        most_m_per_s = greeting.tick_hz * self._axis.units.step_m
        if self._rate(self._axis.max_speed_m_per_s) > greeting.tick_hz:
            raise DriveError(
                FaultKind.REFUSED,
                f"{name}: its highest step rate is {greeting.tick_hz} /s: set max_speed to at most"
                f" {most_m_per_s * 1e3:.4g} mm/s in the actuator's table, or use fewer microsteps",
            )

    def _limits(self, film_full_scale: int) -> BoardLimits:
        axis, scene = self._axis, self._scene
        step_m = axis.units.step_m
        options = LimitOption(0)
        if self._film_counts is not None and self._film_counts[0] > self._film_counts[1]:
            options |= LimitOption.FILM_FALLS
        if scene.inverted:
            options |= LimitOption.INVERTED
        if scene.home_switch == "normally_closed":
            options |= LimitOption.NORMALLY_CLOSED
        if scene.fault_pin != "none":
            options |= LimitOption.HAS_FAULT_PIN
        if scene.fault_pin == "high":
            options |= LimitOption.FAULT_IS_HIGH
        film_least, film_most = self._film_limits(film_full_scale)
        speed_m_per_s = min(FAST_M_PER_S, axis.max_speed_m_per_s)
        return BoardLimits(
            lowest=axis.units.position(axis.lowest_m),
            highest=axis.units.position(axis.furthest_m),
            acceleration=round(axis.max_acceleration_m_per_s2 / step_m),
            highest_rate=self._rate(axis.max_speed_m_per_s),
            film_least=film_least,
            film_most=film_most,
            withdrawal=math.ceil((axis.furthest_m - axis.clear_m) / step_m),
            withdrawal_rate=self._rate(speed_m_per_s),
            watchdog_ms=round(scene.watchdog_ns * 1e-6),
            options=options,
        )

    def _film_limits(self, full_scale: int) -> tuple[int, int]:
        """Return the hard limits of the film, as far as its converter counts. Raises DriveError."""
        if self._film_counts is None:
            return 0, full_scale + 1
        low, high = sorted(self._film_counts)
        # A film at the end of its range has no known force above that.
        least, most = max(0.0, low), min(high, full_scale)
        if math.ceil(least) >= math.floor(most):
            raise DriveError(
                FaultKind.REFUSED,
                f"{self._line.name}: the film's hard limits are counts {low:.0f} to {high:.0f}, and"
                f" its converter counts 0 to {full_scale}: correct zero and newtons_per_count in"
                " the film's table",
            )
        return math.ceil(least), math.floor(most)

    def _search(self) -> HomeSearch:
        axis, scene = self._axis, self._scene
        step_m = axis.units.step_m
        travel = math.floor((axis.furthest_m - axis.lowest_m) / step_m)
        opened = round(OPENED_M / step_m)
        distance = min(SEARCH_SHARE * travel + opened, MOST_SEARCH_SHARE * travel)
        return HomeSearch(
            rate=0 if scene.homing == "none" else self._rate(scene.homing_speed_m_per_s),
            distance=math.floor(distance),
            opening=max(1, min(opened, travel // 2)),
            timeout_ms=min(round(axis.search_s * 1e3), LONGEST_SEARCH_MS),
        )

    def _rate(self, speed_m_per_s: float) -> int:
        return round(speed_m_per_s / self._axis.units.step_m)

    def _unhomed(self, state: BoardState) -> DriveError:
        """Return the error of a search that the board has ended."""
        text = f"{self._line.name}: {TROUBLES[state.cause]}"
        if state.cause in (TripCause.FILM, TripCause.NO_HOME, TripCause.PRESSED):
            return DriveError(FaultKind.WRONG_WAY, f"{text} on the way home; {ADVICE}")
        return DriveError(FaultKind.NOT_HOMED, text)

    def _ask(self, command: Format, *fields: int) -> None:
        """Send a command other than a velocity. Raises DriveError where the board refuses it."""
        answer = self._line.request(command, *fields)
        if answer is None or answer.result is CommandResult.DONE:
            return
        what, field = command.name.lower(), f", field {answer.field}" if answer.field else ""
        result = answer.result.name.lower().replace("_", " ")
        raise DriveError(FaultKind.REFUSED, f"{self._line.name} refuses {what}: {result}{field}")

    def _show_life(self) -> None:
        self._line.send(Format.VELOCITY, 0, self._validity_ms)

    def _disarm(self) -> None:
        """Switch the motor off; a board that may press withdraws before. Raises DriveError."""
        # One that is silent is not waited for.
        self._await_report()
        self._ask(Format.DISARM)
        self._await_mode(lambda mode: mode is BoardMode.DISARMED)

    def _await_mode(self, is_awaited: Callable[[BoardMode], bool]) -> None:
        """Wait for a state, as long as a withdrawal takes at most. Raises DriveError."""
        axis = self._axis
        speed_m_per_s = min(FAST_M_PER_S, axis.max_speed_m_per_s)
        withdrawal_s = (axis.furthest_m - axis.lowest_m) / speed_m_per_s + WITHDRAWAL_MARGIN_S
        until_s = time.monotonic() + withdrawal_s
        while not is_awaited(self._await_report().mode):
            if time.monotonic() > until_s:
                raise DriveError(
                    "fault", f"{self._line.name}: no withdrawal within {withdrawal_s:.1f} s"
                )
            time.sleep(POLL_S)

    def _await_report(self, meanwhile: Callable[[], None] = lambda: None) -> BoardState:
        """Wait for a state that is newer than now, and take it. Raises DriveError.

        meanwhile: called at the begin, and as often as the line is looked at.
        """
        asked_ns, until_s = time.perf_counter_ns(), time.monotonic() + REPORTED_WITHIN_S
        meanwhile()
        while self.received_ns <= asked_ns or self.state is None:
            if self._line.lost or time.monotonic() > until_s:
                kind = self._line.lost_kind if self._line.lost else FaultKind.NO_ANSWER
                raise DriveError(kind, f"{self._line.name}: {self._line.lost or 'no state comes'}")
            time.sleep(POLL_S)
            self.refresh()
            meanwhile()
        return self.state
