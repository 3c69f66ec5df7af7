"""A bench in virtual time for many short tests: a wrist, a display, an emulated motor, its film.

The drive is simplified: the product's `Supervisor` commands the motor without a line, threads or
homing. `threaded_bench.py`, with the real threads, takes 1.7 times as long for the same tests.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from display_node.display import Display
from display_node.plant.scene import StepperScene
from protocol.ticks import TickState
from pulse_drives.axis import Axis, build_axis
from pulse_drives.supervisor import DriveStatus, Supervisor
from pulse_sensors.samples import SampleBlock, Timestamper, decoded_block
from telepulse.emulators.drive_run import FRAME
from telepulse.emulators.motor import EmulatedMotor, MotorState
from tests.support.sender import MS, Sender, display_scene

BATCH = 5
TICK_MS = 2
FIRST_MS = 20
NETWORK_NS = 2 * MS
DELIVERY_NS = MS // 4
# 1 mm/s of the scene's actuator.
TOUCHING_HZ = 1_600.0


class VirtualDrive:
    """A drive that obeys `late_ns` after a command, supervised as the product's drives are."""

    def __init__(self, motor: EmulatedMotor, axis: Axis, late_ns: int, watchdog_ns: int) -> None:
        self.motor, self._axis, self._late_ns = motor, axis, late_ns
        self.now_ns = self.reaches_ns = 0
        self.supervisor = Supervisor(axis, watchdog_ns)
        self.counts: Counter[str] = Counter()
        self.closed = False
        self.arm()

    def arm(self) -> None:
        """Stand at first touch, ready for commands."""
        self.supervisor.arm(self.now_ns)
        self.supervisor.verified = True
        self._read_reports()

    def travel_m(self, now_ns: int) -> float:
        return self.supervisor.travel_m(now_ns)

    def commanded_m(self, now_ns: int) -> float:
        return self.supervisor.commanded_m(now_ns)

    def start(self, force_n: Callable[[], float | None] = lambda: None) -> None:
        """Do nothing: it stands at first touch already."""

    def command(self, speed_m_per_s: float) -> None:
        if self.supervisor.fault is None:
            self.supervisor.command(speed_m_per_s, self.now_ns)
            self._send()

    def run_thread(self, now_ns: int) -> None:
        """Do the work of the drive's own thread, once a millisecond."""
        self.now_ns = self.reaches_ns = now_ns
        self._read_reports()
        self.supervisor.check_silence(now_ns)
        if self.supervisor.fault is not None:
            self._send()

    def add_film_reading(self, force_n: float, taken_ns: int) -> None:
        self.supervisor.add_film_reading(force_n, taken_ns)

    def status(self) -> DriveStatus:
        self._read_reports()
        return self.supervisor.status(self.motor.rate_hz * self._axis.units.step_m)

    def place_finger(self, origin_m: float) -> None:
        self.supervisor.origin_m = origin_m

    def withdraw(self, reason: str) -> None:
        self.supervisor.fail(reason, self.now_ns)

    def close(self) -> None:
        self.closed = True

    def _read_reports(self) -> None:
        motor = self.motor
        motor.advance(self.now_ns)
        self.supervisor.add_position(motor.tip_m, self.now_ns)
        if motor.fault:
            self.supervisor.fail(f"fault: {motor.fault}", self.now_ns)

    def _send(self) -> None:
        sent_ns = max(self.now_ns, self.reaches_ns)
        velocity = self.supervisor.velocity(sent_ns)
        self.supervisor.sent(velocity, sent_ns)
        self.motor.advance(sent_ns + self._late_ns)
        self.motor.feed()
        self.motor.run(velocity)


class VirtualFilm:
    """The film's sensor: four samples a frame, received `DELIVERY_NS` after the last one."""

    def __init__(self, motor: EmulatedMotor, timestamper: Timestamper) -> None:
        self._motor, self._timestamper = motor, timestamper
        self._sent = 0
        self.now_ns = 0
        self.silent = self.closed = False
        self.rejected: Counter[str] = Counter()

    def poll(self) -> list[SampleBlock]:
        found: list[SampleBlock] = []
        forces_n = self._motor.forces_n
        if self.silent:
            return found
        while len(forces_n) >= FRAME and (self._sent + FRAME) * MS + DELIVERY_NS <= self.now_ns:
            self._sent += FRAME
            block = decoded_block([forces_n.popleft() for _ in range(FRAME)], self._sent * MS)
            timestamped = self._timestamper.timestamp(block, self._sent * MS + DELIVERY_NS)
            found += [timestamped] if timestamped is not None else []
        return found

    def faults(self) -> list[str]:
        return ["the film is torn"] if self.silent else []

    def close(self) -> None:
        self.closed = True


@dataclass
class VirtualBench:
    """A bench on which conditions are changed between two runs.

    force_n: the pulse, by ms. loop_runs, thread_runs: the loop and the drive's thread are not
    stalled. loop_first: of the two, the loop wakes first. moments: states of the motor, every ms.
    felt: time, target and felt force of each tick.
    """

    force_n: Callable[[float], float]
    sending: bool = True
    loop_runs: bool = True
    thread_runs: bool = True
    loop_first: bool = False
    command_late_ns: Callable[[int], int] = lambda _: 0

    def __post_init__(self) -> None:
        self.scene = scene = display_scene("tmcl_bench")
        actuator, drive, layer = scene.actuator, scene.drive, scene.layer.layer()
        assert isinstance(actuator, StepperScene)
        assert drive is not None
        assert scene.feedback is not None
        began_ns = -2_000 * MS
        motor = EmulatedMotor(actuator, actuator.contact(layer), drive.touch_m, began_ns)
        to_touch(motor, began_ns)
        motor.advance(0)
        motor.forces_n.clear()
        motor.set_watchdog(drive.watchdog_ns)
        self.moments: list[MotorState] = []
        motor.trace = self.moments.append
        axis = build_axis(drive, actuator, actuator.deepest_m(layer, scene.safety.force_limit_n))
        # The film's delivery is part of the latency that a bench shows.
        late_ns = actuator.latency_ns - DELIVERY_NS
        self.drive = VirtualDrive(motor, axis, late_ns, drive.watchdog_ns)
        self.film = VirtualFilm(motor, Timestamper(scene.feedback))
        self._start_display()
        self.sender = Sender()
        self._waiting: list[tuple[int, bytes]] = []
        self.felt: list[tuple[int, float, float]] = []
        # The film's first samples come before the first tick, as `Hardware.start` sees to.
        self.now_ms = self._ticked_ms = FIRST_MS
        self.drive.now_ns = self.film.now_ns = FIRST_MS * MS
        motor.advance(FIRST_MS * MS)
        self.drive.arm()
        self.hardware.read()

    def run(self, ms: int) -> None:
        """Let time pass: a frame every 5 ms, a tick every 2."""
        for _ in range(ms):
            self.now_ms += 1
            now_ns = self.now_ms * MS
            if self.sending and self.now_ms % BATCH == 0:
                forces_n = [self.force_n(self.now_ms - BATCH + 1 + i) for i in range(BATCH)]
                self._waiting.append((now_ns + NETWORK_NS, self.sender.frame_of(now_ns, forces_n)))
            while self._waiting and self._waiting[0][0] <= now_ns:
                self.display.on_frame(self._waiting.pop(0)[1], now_ns)
            self.drive.motor.advance(now_ns)
            for is_loop in (self.loop_first, not self.loop_first):
                if is_loop and self.loop_runs and self.now_ms % TICK_MS == 0:
                    self._tick(now_ns)
                elif not is_loop and self.thread_runs:
                    self.drive.run_thread(now_ns)

    def stall(self, ms: int) -> None:
        """Let time pass in which the display's process does not run, as after SIGSTOP."""
        self.loop_runs = self.thread_runs = False
        self.run(ms)
        self.loop_runs = self.thread_runs = True

    def restart(self) -> None:
        """Start the display anew after a fault, which brings the drive to first touch."""
        motor = self.drive.motor
        motor.reset()
        motor.set_watchdog(0)
        self.now_ms = to_touch(motor, self.now_ms * MS) // MS
        motor.set_watchdog(self.scene.drive.watchdog_ns if self.scene.drive else 0)
        self.drive.now_ns = self.now_ms * MS
        self.drive.arm()
        self.film.silent, self._ticked_ms = False, self.now_ms
        self._start_display()

    def _start_display(self) -> None:
        self.hardware = self.scene.hardware(self.drive, self.film)  # type: ignore[arg-type]
        self.display = Display(self.scene, "virtual")
        self.display.use(self.hardware)

    def _tick(self, now_ns: int) -> None:
        self.drive.now_ns = self.film.now_ns = now_ns
        elapsed = max(1, (self.now_ms - self._ticked_ms) // TICK_MS)
        self._ticked_ms = self.now_ms
        self.drive.reaches_ns = now_ns + self.command_late_ns(self.now_ms)
        felt: TickState = self.display.tick(now_ns, elapsed)
        while self.display.work():
            pass
        self.felt.append((now_ns, felt.target_n, felt.felt_n))
        if self.sending:
            self.sender.serve(self.display, now_ns)
        else:
            self.display.requests(now_ns)


def to_touch(motor: EmulatedMotor, now_ns: int) -> int:
    """Move the tip off the finger, then to first touch; return the time of the touch."""
    for rate_hz in (-TOUCHING_HZ, TOUCHING_HZ):
        motor.run(rate_hz)
        while (motor.tip_m < 0) is (rate_hz > 0):
            now_ns += MS
            motor.advance(now_ns)
    motor.run(0.0)
    return now_ns
