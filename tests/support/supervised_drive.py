"""A drive's host side in virtual time, with a modelled device, finger and film, under any events.

The product's own `TmclDrive` and `Cia402Drive` run in place of their threads' loops, so that what
they do with `Supervisor` and `Withdrawal` is searched as well. The device is modelled as they see
it, without its bytes: that is a hundred times as fast as an emulator. After each millisecond
`Invariants` holds what is claimed against what is true.
"""

import math
import random
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple
from unittest.mock import patch

from protocol.errors import DriveError
from protocol.faults import Fault, FaultKind, Part
from pulse_drives.axis import Axis, build_axis
from pulse_drives.cia402.drive import Cia402Drive
from pulse_drives.cia402.node import EVENT_MS, OPERATIONAL, Cia402Node
from pulse_drives.cia402.state_machine import Controlword, State
from pulse_drives.drive import Drive
from pulse_drives.following_error import TOLERANCE_M
from pulse_drives.supervisor import FILM_IS_WRONG, UNSENT_NS
from pulse_drives.tmcl.drive import TmclDrive
from pulse_drives.tmcl.module import Parameter, TmclModule
from pulse_drives.withdrawal import (
    FILM_SILENT_NS,
    OVERDUE_NS,
    PATIENCE_NS,
    PRESSED_N,
    WithdrawalOutcome,
)
from tests.support.drive_benches import FORCE_LIMIT_N, LAYER, cia402_scene, stepper, tmcl_scene

MS = 1_000_000
# A clock that begins at 0 would hide what is taken for a time that has not come.
STARTS_MS = 1_000
KINDS = ("tmcl", "cia402")
WATCHDOG_MS = 50
REPLY_TIMEOUT_MS = 10
# The real ones read the clock in these modules.
CLOCKS = ("pulse_drives.drive.time", "pulse_drives.tmcl.drive.time")

SPEEDS_M_PER_S = (
    *(0.0, 1e-3, -1e-3, 5e-3, -5e-3, 20e-3, -20e-3, 60e-3, -60e-3, 0.4, -0.4, 10.0, -10.0),
    *(math.nan, math.inf, -math.inf),
)
STALLS_MS = (1, 2, 5, 10, 20, 29, 31, 40, 49, 51, 60, 100, 200, 400, 1_000, 3_000, 10_000)
LATENCIES_MS = (0, 2, 4, 8, 20)
FAULTS = (
    *((kind, part) for kind in sorted(FILM_IS_WRONG) for part in (Part.FILM, Part.LOAD_CELL)),
    *((kind, Part.FILM) for kind in (FaultKind.OVERFORCE, FaultKind.RISING)),
    *((kind, Part.LOOP) for kind in (FaultKind.OVERRUN, FaultKind.INTERNAL)),
    *((kind, Part.DRIVE) for kind in (FaultKind.DRIVE_FAULT, FaultKind.INTERNAL)),
    (FaultKind.INTERNAL, Part.FILM),
)
FILMS = (
    *("good", "good", "stuck", "late", "silent", "noisy", "torn", "full", "half", "double"),
    "drifting",
)
LATE_FILM_MS = 60
JUMPS_M = (30e-6, -30e-6, 140e-6, -140e-6, 400e-6, -400e-6, 2e-3, -2e-3)
LINES = ("unanswered", "cut", "deaf", "twice")
TROUBLES = ("fault", "block", "drop", "reverse")
ORIGINS_M = (0.0, -0.2e-3, -0.5e-3, -1e-3)


def film_is_trusted(fault: Fault) -> bool:
    """Return whether a fault leaves the film trusted, as a display judges it."""
    return fault.part not in (Part.FILM, Part.LOAD_CELL) or fault.kind not in FILM_IS_WRONG


class Event(NamedTuple):
    """What happens `after_ms` the last event. value: chooses among what can happen, 0 to 255."""

    name: str
    after_ms: int = 0
    value: int = 0


#: Most events find a tip on the finger.
PRESS = Event("speed", 0, SPEEDS_M_PER_S.index(20e-3))
EVENTS = (
    *("speed", "speed", "speed", "speed", "host stall", "loop stall", "drive stall", "fault"),
    *("film", "latency", "line", "jump", "freeze", "trouble", "origin", "end"),
)


class InvariantError(AssertionError):
    """A claim or a motion that no drive's host may make."""


class Plant:
    """A motor with ramps and a watchdog, its travel and the finger. Positions in m, true ones."""

    def __init__(self, axis: Axis, has_encoder: bool) -> None:
        self._axis = axis
        # Without one it counts the steps that it gives.
        self._has_encoder = has_encoder
        self._law = stepper().contact(LAYER)
        self.tip_m = self.counted_m = 0.0
        self.speed = self.target = 0.0
        self.finger_m = 0.0
        self.force_n = 0.0
        self.fed_ms = 0
        self.tripped = False
        # Until when it does not move, and moves the other way.
        self.blocked_until_ms = self.reversed_until_ms = 0

    def tick(self, now_ms: int) -> None:
        if now_ms - self.fed_ms > WATCHDOG_MS:
            self.target, self.tripped = 0.0, True
        most = self._axis.max_acceleration_m_per_s2 * 1e-3
        self.speed += min(max(self.target - self.speed, -most), most)
        moved_m = self.speed * 1e-3
        if moved_m < 0 and self.tip_m + moved_m < self._axis.lowest_m:
            # The home switch.
            moved_m, self.speed = min(self._axis.lowest_m - self.tip_m, 0.0), 0.0
        turned_m = moved_m
        if now_ms < self.blocked_until_ms:
            moved_m = 0.0
        elif now_ms < self.reversed_until_ms:
            moved_m = -moved_m
        self.tip_m += moved_m
        self.counted_m += moved_m if self._has_encoder else turned_m
        self.force_n = self._law.force(self.tip_m - self.finger_m)


class Line:
    """The way of commands and answers, and what the drive reports."""

    def __init__(self) -> None:
        self.mode, self.until_ms = "", 0
        self.offset_m = 0.0
        self.frozen_m: float | None = None
        self.frozen_until_ms = 0

    def is_in(self, now_ms: int, *modes: str) -> bool:
        return now_ms < self.until_ms and self.mode in modes

    def reported_m(self, true_m: float, now_ms: int) -> float:
        if now_ms >= self.frozen_until_ms:
            self.frozen_m = None
        return true_m + self.offset_m if self.frozen_m is None else self.frozen_m


class ModelledModule(TmclModule):
    """A TMCL module as `TmclDrive` sees it; an exchange takes one or two milliseconds."""

    def __init__(self, world: "World") -> None:
        self._world = world
        self.position_m, self.position_ns = world.plant.tip_m, world.now_ns
        self.speed_m_per_s, self.received_ns = 0.0, world.now_ns
        self.switch, self.switch_ns = Parameter.LEFT_SWITCH_STATE, 0
        self.switch_requested = self.switch_closed = False

    def rotate(self, velocity: int) -> None:
        world = self._world
        if world.carries_commands:
            world.deliver(velocity)
        self._answer()

    def read(self, parameter: Parameter) -> None:
        world = self._world
        self._answer()
        if parameter is Parameter.ACTUAL_POSITION:
            self.position_m, self.position_ns = world.reported_m, world.now_ns
        elif parameter is Parameter.ACTUAL_SPEED:
            self.speed_m_per_s = world.plant.speed
        elif parameter is Parameter.ERROR_FLAGS and world.has_fault:
            raise DriveError(FaultKind.DRIVE_FAULT, "stall")

    def close(self) -> None:
        self._world.deliver(0)

    def _answer(self) -> None:
        world = self._world
        if world.line.is_in(world.now_ms, "unanswered", "cut", "deaf"):
            world.run(REPLY_TIMEOUT_MS)
            raise DriveError(FaultKind.NO_ANSWER, "no answer")
        world.run(1 + (world.now_ms & 1))
        if world.line.is_in(world.now_ms, "twice") and world.now_ms % 3:
            raise DriveError(FaultKind.WRONG_DEVICE, "an answer to another command")
        self.received_ns = world.now_ns


class ModelledNode(Cia402Node):
    """A CiA 402 drive as `Cia402Drive` sees it."""

    def __init__(self, world: "World") -> None:
        self._world = world
        self.counts = Counter()
        self.statusword = self.error_code = 0
        self.state = self._state = State.ENABLED
        self._control = Controlword.ENABLE
        self.position_m, self.speed_m_per_s = world.plant.tip_m, 0.0
        self.received_ns, self._implausible_ns = world.now_ns, 0
        self._internal = None
        self._nmt_state = OPERATIONAL

    def command(self, control: Controlword, velocity: int) -> int:
        world = self._world
        if world.carries_commands:
            self._take_control(control)
            if self._state is State.ENABLED:
                world.deliver(velocity, feeds=False)
        return world.now_ns

    def send_heartbeat(self) -> None:
        if self._world.carries_commands:
            self._world.feed()

    def start_again(self) -> None:
        pass

    def close(self) -> None:
        self._world.plant.target = 0.0

    def tick(self) -> None:
        """Report each 10 ms, and stop on a heartbeat that is missing and on a fault."""
        world = self._world
        if world.plant.tripped and self._state is State.ENABLED:
            # Its reaction is a quick stop, after which some are disabled, and others in fault.
            self._state = State.FAULT if world.now_ms & 1 else State.QUICK_STOP
        if world.has_fault:
            self._state = State.FAULT
        if world.drops:
            self._state = State.SWITCH_ON_DISABLED
            world.drops = False
        if self._state is not State.ENABLED:
            world.plant.target = 0.0
            if self._state is State.QUICK_STOP and world.plant.speed == 0.0:
                self._state = State.SWITCH_ON_DISABLED
        if world.now_ms % EVENT_MS == 0 and not world.line.is_in(world.now_ms, "unanswered", "cut"):
            self.state = self._state
            self.position_m, self.speed_m_per_s = world.reported_m, world.plant.speed
            self.received_ns = world.now_ns

    def _take_control(self, control: Controlword) -> None:
        last, self._control = self._control, control
        state = self._state
        if state is State.FAULT:
            resets = control == Controlword.RESET_FAULT != last
            self._state = State.SWITCH_ON_DISABLED if resets else state
        elif control == Controlword.DISABLE_VOLTAGE:
            self._state = State.SWITCH_ON_DISABLED
        elif (state, control) in (
            (State.SWITCH_ON_DISABLED, Controlword.SHUTDOWN),
            (State.SWITCHED_ON, Controlword.SHUTDOWN),
        ):
            self._state = State.READY
        elif (state, control) == (State.READY, Controlword.SWITCH_ON):
            self._state = State.SWITCHED_ON
        elif (state, control) == (State.SWITCHED_ON, Controlword.ENABLE):
            self._state = State.ENABLED


class Film:
    """A film under the finger, with a latency that its scene knows, and troubles that it does not.

    truthful_since_ms: when it last began to read the force that is there.
    """

    def __init__(self) -> None:
        self.mode = "good"
        self.latency_ms = 4
        self.truthful_since_ms = 0
        self._forces = deque([0.0], maxlen=LATE_FILM_MS + max(LATENCIES_MS) + 1)
        self._stuck_n = 0.0

    def set(self, mode: str, now_ms: int) -> None:
        self.mode, self._stuck_n = mode, self._forces[-1]
        self.truthful_since_ms = now_ms

    def tick(self, force_n: float) -> None:
        self._forces.append(force_n)

    def reading(self, now_ms: int) -> tuple[float, int] | None:
        """Return the newest force and the time at which the host takes it to be measured."""
        mode, taken_ns = self.mode, (now_ms - self.latency_ms) * MS
        age = self.latency_ms + (LATE_FILM_MS if mode == "late" else 0)
        force_n = self._forces[-1 - min(age, len(self._forces) - 1)]
        if mode == "silent":
            return None
        if mode == "stuck":
            # A sensor's noise goes on, as in a film that is stuck mechanically.
            force_n = self._stuck_n * (1 + 0.5 * ((now_ms // 7) % 3))
        elif mode == "noisy":
            force_n += 0.4 * ((now_ms * 7919) % 17 / 8 - 1)
        elif mode in ("torn", "full"):
            force_n = 0.0 if mode == "torn" else 5.0
        elif mode == "drifting":
            force_n += 50e-3 * (now_ms - self.truthful_since_ms)
        elif mode in ("half", "double"):
            force_n *= 0.5 if mode == "half" else 2.0
        return force_n, taken_ns


class _Thread:
    """The drive's thread, which the world runs in its place."""

    def stop(self, _: float) -> bool:
        return True


class World:
    """One drive and all around it, from first touch on; times in ms.

    It is the clock of the drive's modules as well: `perf_counter_ns`, `monotonic` and `sleep`.
    """

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.now_ms = STARTS_MS
        patient = {"touch": "2 mm", "watchdog": f"{WATCHDOG_MS} ms"}
        actuator = stepper()
        deepest_m = actuator.deepest_m(LAYER, FORCE_LIMIT_N)
        self.drive: Drive
        if kind == "tmcl":
            scene = tmcl_scene(port="x", reply_timeout=f"{REPLY_TIMEOUT_MS} ms", **patient)
            self.axis = build_axis(scene, actuator, deepest_m)
            self.drive = TmclDrive(scene, self.axis)
        else:
            other = cia402_scene(**patient)
            self.axis = build_axis(other, actuator, deepest_m)
            self.drive = Cia402Drive(other, self.axis)
        self.plant, self.line, self.film = Plant(self.axis, kind == "cia402"), Line(), Film()
        self.plant.fed_ms = self.now_ms
        self.wanted = 0.0
        self.has_fault = self.drops = self.closing = False
        self.fault_until_ms = self.loop_until_ms = self.drive_until_ms = 0
        # Commands that reached the drive since its fault.
        self.delivered = 0
        self.node: ModelledNode | None = None
        self._stepping = False
        self._step_ms = 0
        self._connect()
        self.invariants = Invariants(self)

    def _connect(self) -> None:
        drive: Any = self.drive
        if self.kind == "tmcl":
            with patch("pulse_drives.tmcl.drive.TmclModule", lambda *_: ModelledModule(self)):
                device = drive._connect()
        else:
            with patch("pulse_drives.cia402.drive.Cia402Node", lambda *_: ModelledNode(self)):
                device = self.node = drive._connect()
        drive._device, drive._thread = device, _Thread()
        drive._supervisor.arm(self.now_ns)
        drive._supervisor.add_position(0.0, self.now_ns)
        drive._supervisor.verified = True
        self.supervisor = drive._supervisor

    # The clock.
    @property
    def now_ns(self) -> int:
        return self.now_ms * MS

    def perf_counter_ns(self) -> int:
        return self.now_ns

    def monotonic(self) -> float:
        return self.now_ms * 1e-3

    def sleep(self, seconds: float) -> None:
        self.run(max(1, round(seconds * 1e3)))

    # What the device does.
    @property
    def carries_commands(self) -> bool:
        return not self.line.is_in(self.now_ms, "cut", "deaf")

    @property
    def reported_m(self) -> float:
        return self.line.reported_m(self.plant.counted_m, self.now_ms)

    def feed(self) -> None:
        self.plant.fed_ms, self.plant.tripped = self.now_ms, False

    def deliver(self, velocity: int, feeds: bool = True) -> None:
        if feeds:
            self.feed()
        self.delivered += 1
        if not self.has_fault:
            self.plant.target = self.axis.units.speed_m_per_s(velocity)

    # What happens.
    def run(self, ms: int) -> None:
        """Let time pass, with what the loop and the drive's thread do meanwhile."""
        for _ in range(ms):
            self._tick_device()
            self.film.tick(self.plant.force_n)
            loop_lives = self.now_ms >= self.loop_until_ms
            if loop_lives and not self.closing:
                self._tick_loop()
            if not self._stepping and self.now_ms >= max(self._step_ms, self.drive_until_ms):
                self._stepping = True
                try:
                    self.drive._step()
                except InvariantError:
                    raise
                except Exception as error:
                    # As the guard of its thread does.
                    self.drive._on_error(error)
                finally:
                    self._stepping = False
                self._step_ms = self.now_ms + (1 if self.kind == "tmcl" else 5)
            self.invariants.check()

    def _tick_device(self) -> None:
        self.now_ms += 1
        self.has_fault = self.now_ms < self.fault_until_ms
        if self.has_fault:
            self.plant.target = 0.0
        self.plant.tick(self.now_ms)
        if self.node is not None:
            self.node.tick()

    def _tick_loop(self) -> None:
        drive = self.drive
        if (reading := self.film.reading(self.now_ms)) is not None:
            drive.add_force_reading(*reading)
            self.invariants.film_read(*reading)
        status = drive.status()
        self.invariants.shown(status.withdrawal, self.now_ms >= self.drive_until_ms)
        if self.now_ms & 1:
            if status.fault is None:
                drive.command(self.wanted)
            else:
                drive.withdraw(status.fault)

    def stall(self, ms: int) -> None:
        """Stop loop and drive's thread at once, as SIGSTOP does."""
        for _ in range(ms):
            self._tick_device()
            self.film.tick(self.plant.force_n)
        self.invariants.stalled()

    def happen(self, event: Event) -> None:
        value, ms = event.value, STALLS_MS[event.value % len(STALLS_MS)]
        until_ms = self.now_ms + ms
        match event.name:
            case "speed":
                self.wanted = SPEEDS_M_PER_S[value % len(SPEEDS_M_PER_S)]
            case "host stall":
                self.stall(ms)
                if value & 128:
                    # The loop wakes first.
                    self._step_ms = self.now_ms + 2
            case "loop stall":
                self.loop_until_ms = until_ms
            case "drive stall":
                self.drive_until_ms = until_ms
            case "fault":
                kind, part = FAULTS[value % len(FAULTS)]
                fault = Fault(kind, part, "searched")
                self.drive.withdraw(fault, film_is_trusted(fault))
            case "film":
                self.film.set(FILMS[value % len(FILMS)], self.now_ms)
            case "latency":
                self.film.latency_ms = LATENCIES_MS[value % len(LATENCIES_MS)]
            case "line":
                self.line.mode = LINES[value % len(LINES)]
                self.line.until_ms = self.now_ms + STALLS_MS[value // 4 % len(STALLS_MS)]
            case "jump":
                self.line.offset_m += JUMPS_M[value % len(JUMPS_M)]
            case "freeze":
                self.line.frozen_m, self.line.frozen_until_ms = self.reported_m, until_ms
            case "trouble":
                self._trouble(TROUBLES[value % 4], STALLS_MS[value // 4 % len(STALLS_MS)])
            case "origin":
                self._place_finger(ORIGINS_M[value % len(ORIGINS_M)])
            case "end":
                self.drive.withdraw()

    def _trouble(self, trouble: str, ms: int) -> None:
        until_ms = self.now_ms + ms
        match trouble:
            case "fault":
                self.fault_until_ms = until_ms
            case "block":
                self.plant.blocked_until_ms = until_ms
            case "drop":
                self.drops = True
            case "reverse":
                self.plant.reversed_until_ms = until_ms

    def _place_finger(self, origin_m: float) -> None:
        """Let a finger follow the tip, before a fault."""
        if self.supervisor.fault is None and self.plant.tip_m <= origin_m:
            self.plant.finger_m = origin_m
            self.drive.place_finger(origin_m)


class Invariants:
    """What holds in each millisecond, whatever happens. Raises InvariantError.

    Excused is only what no host can know: a position that is wrong by more than a following error
    is noticed by, and a film that goes wrong once nobody checks it any more.
    """

    #: Past the end of the travel: a report may be wrong by the tolerance, and is followed by 7 %.
    BEYOND_M = 2 * TOLERANCE_M
    #: From a fault to the first command that the drive takes: an exchange, or a lost answer.
    REACTION_MS = 15
    #: An obeying drive's tip is off: a second, a motion that is not shown, and enabling it again.
    GONE_WITHIN_MS = 1_000 + PATIENCE_NS // MS + 100
    #: Of a withdrawal that is shown as under way, with a drive that is enabled again.
    UNDER_WAY_MS = (OVERDUE_NS + UNSENT_NS) // MS + 50
    UNSENT_MS = UNSENT_NS // MS + 50

    def __init__(self, world: World) -> None:
        self._world = world
        self._fault: Fault | None = None
        self._outcome: WithdrawalOutcome | None = None
        self._reading_n, self._reading_ms = 0.0, -1_000
        # Times in ms at which a report was last wrong by more than is noticed, and a motor turned
        # the wrong way.
        self._lied_ms = self._reversed_ms = -1_000_000
        self._began_ms = self._obeyed_ms = self._under_way_ms = self._unsent_ms = 0
        self._peak_m = math.inf
        self._quick_m = math.inf
        self._found: list[str] = []
        supervisor: Any = world.supervisor
        self._velocity = supervisor.velocity_to_send
        supervisor.velocity_to_send = self._checked_velocity

    def _checked_velocity(self, now_ns: int) -> int:
        fault = self._world.supervisor.fault
        velocity = self._velocity(now_ns)
        if fault is not None and self._world.axis.units.speed_m_per_s(velocity) > 0:
            # The drive takes an exception for its device's.
            self._found.append(f"{velocity} is sent towards the finger after {fault}")
        return int(velocity)

    def film_read(self, force_n: float, taken_ns: int) -> None:
        self._reading_n, self._reading_ms = force_n, taken_ns // MS

    def stalled(self) -> None:
        self._obeyed_ms = 0
        self._note_lies()

    def shown(self, outcome: WithdrawalOutcome | None, thread_lives: bool) -> None:
        """Take the state of the withdrawal that the screens show."""
        if outcome is not WithdrawalOutcome.UNDER_WAY:
            self._unsent_ms = 0
            return
        if thread_lives:
            self._under_way_ms += 1
            self._unsent_ms = 0
        else:
            self._unsent_ms += 1
        if self._under_way_ms > self.UNDER_WAY_MS or self._unsent_ms > self.UNSENT_MS:
            self._fail("the withdrawal is shown as under way for too long")

    def check(self) -> None:
        world, plant = self._world, self._world.plant
        if self._found:
            self._fail(self._found[0])
        if errors := [name for name in world.drive.counts if name.startswith("error: ")]:
            self._fail(f"the drive has met {errors[0]}")
        self._note_lies()
        far_m = world.axis.furthest_m + self.BEYOND_M
        # Steps that a motor has lost on its way out show at the film alone, which the loop checks.
        if plant.counted_m > far_m and self._reversed_ms < 0:
            self._fail("the tip is beyond its travel")
        fault = world.supervisor.fault
        if self._fault is not None:
            if fault is not self._fault:
                self._fail(f"{self._fault} is replaced by {fault}")
            self._check_withdrawal()
        elif fault is not None:
            self._fault, self._began_ms, world.delivered = fault, world.now_ms, 0
            # The withdrawal has none yet.
            self._reading_ms = -1_000
            fastest = max(plant.target, plant.speed, 0.0)
            braking_m = fastest**2 / 2 / world.axis.max_acceleration_m_per_s2
            self._peak_m = plant.tip_m + fastest * (WATCHDOG_MS + 2) * 1e-3 + braking_m
            self._quick_m = plant.tip_m + fastest * self.REACTION_MS * 1e-3 + braking_m

    def _note_lies(self) -> None:
        world, plant = self._world, self._world.plant
        if abs(world.reported_m - plant.tip_m) > TOLERANCE_M:
            self._lied_ms = world.now_ms
        if world.now_ms < plant.reversed_until_ms:
            self._reversed_ms = world.now_ms

    def _check_withdrawal(self) -> None:
        world, plant = self._world, self._world.plant
        withdrawal = world.supervisor.withdrawal
        assert withdrawal is not None
        outcome, before = withdrawal.outcome, self._outcome
        self._outcome = outcome
        if self._reversed_ms < self._began_ms:
            if world.delivered:
                # What is left is to brake.
                braking_m = max(plant.speed, 0.0) ** 2 / 2 / world.axis.max_acceleration_m_per_s2
                left_m = plant.tip_m + max(plant.speed, 0.0) * 1e-3 + braking_m
                self._peak_m = min(self._peak_m, max(left_m, plant.tip_m))
            if plant.tip_m > self._peak_m + 1e-6:
                self._fail("the tip goes on towards the finger after a fault")
        if outcome is WithdrawalOutcome.WITHDRAWN:
            if plant.force_n > 0 and not self._position_lied:
                self._fail("withdrawn, although the tip is on the finger")
            if outcome is not before:
                self._check_film_at_end()
        elif outcome is WithdrawalOutcome.WRONG_WAY is not before:
            self._check_wrong_way(withdrawal.stopped_by_film)
        self._obeyed_ms = self._obeyed_ms + 1 if self._obeys else 0
        if self._obeyed_ms == self.GONE_WITHIN_MS and plant.force_n > 0 and not self._is_excused:
            self._fail("the tip is not off the finger in time")

    def _check_film_at_end(self) -> None:
        known = self._world.now_ms - self._reading_ms <= FILM_SILENT_NS // MS
        if self._film_is_trusted and known and self._reading_n > PRESSED_N:
            self._fail("withdrawn, although the film reads a press")

    def _check_wrong_way(self, by_film: bool) -> None:
        if by_film and not self._film_is_trusted:
            self._fail("a film that was found at fault stops the withdrawal")
        if self._reversed_ms < self._began_ms and not (
            self._film_lied if by_film else self._position_lied
        ):
            self._fail("a withdrawal that goes away from the finger is stopped")

    @property
    def _film_is_trusted(self) -> bool:
        fault = self._fault
        assert fault is not None
        return film_is_trusted(fault)

    @property
    def _position_lied(self) -> bool:
        """Whether it is wrong by more than a following error, and too late to be one."""
        return self._lied_ms > self._began_ms - 100

    @property
    def _film_lied(self) -> bool:
        film = self._world.film
        return film.mode != "good" or film.truthful_since_ms > self._began_ms - 100

    @property
    def _obeys(self) -> bool:
        world, plant = self._world, self._world.plant
        now_ms = world.now_ms
        return (
            now_ms >= max(world.drive_until_ms, world.line.until_ms, world.line.frozen_until_ms)
            and now_ms >= max(plant.blocked_until_ms, plant.reversed_until_ms)
            and not world.has_fault
        )

    @property
    def _is_excused(self) -> bool:
        world = self._world
        withdrawal = world.supervisor.withdrawal
        assert withdrawal is not None
        if self._reversed_ms > self._began_ms - 100:
            return True
        if self._position_lied and world.supervisor.position_m <= world.axis.lowest_m:
            # It has lost steps: by its count it is at home, where it must not go on.
            return True
        match withdrawal.outcome:
            case WithdrawalOutcome.WRONG_WAY if withdrawal.stopped_by_film:
                return self._film_lied
            case WithdrawalOutcome.RELIEVED:
                return self._film_lied
            case WithdrawalOutcome.WRONG_WAY | WithdrawalOutcome.WITHDRAWN:
                return self._position_lied
        return False

    def _fail(self, what: str) -> None:
        world = self._world
        outcome = "none" if self._outcome is None else self._outcome.value
        raise InvariantError(
            f"{what}: {world.kind} at {world.now_ms} ms, tip {world.plant.tip_m * 1e3:.3f} mm,"
            f" {world.plant.force_n * 1e3:.0f} mN, withdrawal {outcome}, fault {self._fault}"
        )


TAIL_MS = 1_500 + Invariants.GONE_WITHIN_MS


@contextmanager
def clocked(world: World) -> Iterator[None]:
    with ExitStack() as stack:
        for place in CLOCKS:
            stack.enter_context(patch(place, world))
        yield


def play(kind: str, events: Iterable[Event]) -> World:
    """Play events on a drive, then end the run. Raises InvariantError.

    Returns the world at its end, with the drive closed.
    """
    world = World(kind)
    with clocked(world):
        for event in events:
            world.run(event.after_ms)
            world.happen(event)
        world.drive.withdraw()
        world.run(TAIL_MS)
        world.closing = True
        world.drive.close()
        world.closing = False
    return world


def events_of(numbers: Iterable[tuple[int, int, int]]) -> list[Event]:
    """Return the events of triples of bytes: name, time since the last one, and value."""
    return [
        Event(EVENTS[name % len(EVENTS)], after_ms % 128 if after_ms < 224 else 4 * after_ms, value)
        for name, after_ms, value in numbers
    ]


def random_events(rng: random.Random) -> list[Event]:
    """Return events that begin with a press."""
    length = rng.randrange(1, 16)
    numbers = [(rng.randrange(256), rng.randrange(256), rng.randrange(256)) for _ in range(length)]
    return [Event("speed", 0, rng.choice((3, 5, 5, 7))), *events_of(numbers)]


def finding(kind: str, events: Iterable[Event]) -> InvariantError | None:
    """Return the first invariant that does not hold; None if all do."""
    try:
        play(kind, events)
    except InvariantError as error:
        return error
    return None


def shrunk(kind: str, events: list[Event]) -> list[Event]:
    """Return the fewest of some events, by leaving out one after another, that still fail."""
    at = 0
    while at < len(events):
        fewer = events[:at] + events[at + 1 :]
        if finding(kind, fewer) is None:
            at += 1
        else:
            events = fewer
    return events
