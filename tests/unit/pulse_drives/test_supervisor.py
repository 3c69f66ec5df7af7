"""Commands to a drive, whatever the loop, the host and the drive do."""

import random

import pytest

from protocol.faults import Fault, FaultKind, Part
from pulse_drives.axis import Axis, build_axis
from pulse_drives.supervisor import PATIENCE_S, Supervisor, TimeoutLock
from pulse_drives.withdrawal import WithdrawalOutcome
from tests.support.drive_benches import FORCE_LIMIT_N, LAYER, stepper, tmcl_scene
from tests.support.virtual_time import VirtualTime

MS = 1_000_000
WATCHDOG_NS = 50 * MS


def axis() -> Axis:
    scene = tmcl_scene(port="x", touch="2 mm", watchdog="50 ms", reply_timeout="10 ms")
    return build_axis(scene, stepper(), stepper().deepest_m(LAYER, FORCE_LIMIT_N))


class Bench:
    """A drive that executes commands at once, and reports its position every 2 ms."""

    def __init__(self, verified: bool = True) -> None:
        self.axis = axis()
        self.supervisor = Supervisor(self.axis, WATCHDOG_NS, WATCHDOG_NS)
        self.supervisor.arm(0)
        self.supervisor.verified = verified
        self.tip_m = self.speed = 0.0
        self.furthest_m = 0.0
        self.now_ms = 0
        self.frozen_m: float | None = None
        self.speeds: list[float] = []

    def run(self, ms: int, speed_m_per_s: float | None = None) -> Supervisor:
        """Step once a millisecond, with a command unless it is None."""
        supervisor, units = self.supervisor, self.axis.units
        for _ in range(ms):
            self.now_ms += 1
            now_ns = self.now_ms * MS
            self.tip_m += self.speed * 1e-3
            self.furthest_m = max(self.furthest_m, self.tip_m)
            if self.now_ms % 2:
                place_m = self.tip_m if self.frozen_m is None else self.frozen_m
                supervisor.add_position(place_m, now_ns)
            if speed_m_per_s is not None:
                supervisor.set_target(speed_m_per_s, now_ns)
            supervisor.check_silence(now_ns)
            velocity = supervisor.velocity_to_send(now_ns)
            supervisor.mark_sent(velocity, now_ns)
            self.speed = units.speed_m_per_s(velocity)
            self.speeds.append(self.speed)
        return supervisor


@pytest.mark.parametrize("stalled_ms", [51, 100, 400, 10_000])
def test_after_a_stall_of_the_host_the_tip_withdraws(stalled_ms: int) -> None:
    bench = Bench()
    bench.run(40, 10e-3)
    # Meanwhile the drive's own watchdog has stopped the motor.
    bench.now_ms += stalled_ms
    bench.speed = 0.0
    supervisor = bench.run(200)
    assert str(supervisor.fault) == f"loop: no command for {stalled_ms + 1} ms"
    assert supervisor.status(0.0, bench.now_ms * MS).withdrawal is WithdrawalOutcome.WITHDRAWN
    assert bench.tip_m < -0.4e-3


def test_a_loop_without_commands_is_a_fault_but_not_in_a_pause() -> None:
    bench = Bench()
    bench.run(40, 10e-3)
    assert bench.run(45).fault is None
    assert "no command" in str(bench.run(10).fault)
    again = Bench()
    again.supervisor.pause()
    assert again.run(500).fault is None


@pytest.mark.parametrize(
    ("answers", "fault", "after_ms"),
    [(False, "drive: no answer for 51 ms", 50), (True, "drive: no position for 201 ms", 200)],
)
def test_a_drive_without_answers_or_positions_is_a_fault(
    answers: bool, fault: str, after_ms: int
) -> None:
    supervisor = Supervisor(axis(), WATCHDOG_NS, WATCHDOG_NS)
    supervisor.arm(0)
    for ms in range(1, 250):
        supervisor.set_target(0.0, ms * MS)
        if answers:
            supervisor.answered_ns = ms * MS
        supervisor.check_silence(ms * MS)
        named = None if supervisor.fault is None else str(supervisor.fault)
        assert named == (None if ms <= after_ms else fault)


def test_a_constant_position_is_a_following_error_and_bounds_the_travel() -> None:
    bench = Bench()
    bench.run(20, 5e-3)
    bench.frozen_m = bench.tip_m
    supervisor = bench.run(1_000, 20e-3)
    assert "following error" in str(supervisor.fault)
    # 150 µm, the travel while positions may be late, and that until the error is a fault.
    assert bench.furthest_m < bench.frozen_m + 1.2e-3
    outcome = supervisor.status(0.0, bench.now_ms * MS).withdrawal
    assert outcome is WithdrawalOutcome.UNCONFIRMED
    assert bench.tip_m < -0.5e-3


@pytest.mark.parametrize("seed", range(5))
def test_a_drive_that_follows_is_no_fault(seed: int) -> None:
    bench, rng = Bench(), random.Random(seed)
    for _ in range(400):
        supervisor = bench.run(rng.randrange(2, 30), rng.uniform(-20e-3, 20e-3))
        assert supervisor.fault is None


def test_wrong_positions_do_not_lead_beyond_the_travel() -> None:
    bench = Bench()
    bench.run(10, 5e-3)
    bench.frozen_m = 0.0
    bench.run(2_000, 60e-3)
    assert bench.furthest_m <= bench.axis.furthest_m


def test_before_the_direction_is_verified_a_fault_leaves_the_drive_at_rest() -> None:
    bench = Bench(verified=False)
    bench.run(40, 10e-3)
    bench.supervisor.fail(Fault(FaultKind.WRONG_WAY, Part.DRIVE, "wrong way", bench.now_ms * MS))
    bench.run(100)
    assert bench.speeds[-100:] == [0.0] * 100
    assert bench.supervisor.withdrawal is None


def test_the_first_fault_stays() -> None:
    bench = Bench()
    bench.run(40, 10e-3)
    fault = Fault(FaultKind.SILENT, Part.FILM, "feedback lost", bench.now_ms * MS)
    bench.supervisor.fail(fault)
    bench.now_ms += 500
    assert bench.run(100).fault is fault


def test_a_lock_times_out_while_its_holder_stalls_and_then_excludes_again() -> None:
    world, entries = VirtualTime(now_ns=0), list[tuple[str, float]]()
    with world.substituted(("pulse_drives.supervisor",)):
        lock = TimeoutLock()

    def loop() -> None:
        for held_s in (1.0, 0.02):
            with lock:
                entries.append(("loop", world.monotonic()))
                world.sleep(held_s)
            world.sleep(0.001)

    def drive() -> None:
        world.sleep(0.5)
        for _ in range(2):
            with lock.acquire_or_proceed():
                entries.append(("drive", world.monotonic()))
        for sleep_s in (0.4505, 0.0095):
            world.sleep(sleep_s)
            with lock.acquire_or_proceed():
                entries.append(("drive", world.monotonic()))

    world.thread(loop)
    world.thread(drive).join()
    # The drive's first entry waits for PATIENCE_S, its second not at all, its last for the loop.
    times_s = [0.0, 0.5 + PATIENCE_S, 0.5 + PATIENCE_S, 1.0005, 1.001, 1.021]
    assert [name for name, _ in entries] == ["loop", *["drive"] * 3, "loop", "drive"]
    assert [time_s for _, time_s in entries] == pytest.approx(times_s)


@pytest.mark.parametrize(("force_n", "goes_on"), [(0.8, True), (0.0, False)])
def test_a_tip_that_is_home_by_its_count_alone_is_withdrawn_on(
    force_n: float, goes_on: bool
) -> None:
    """Steps were lost on the way, and a film that can be trusted still reads a press."""
    bench = Bench()
    bench.run(40, 10e-3)
    bench.supervisor.fail(Fault(FaultKind.NO_COMMAND, Part.LOOP, "none", bench.now_ms * MS))
    for _ in range(600):
        bench.supervisor.add_force_reading(force_n, bench.now_ms * MS)
        bench.run(1)
    assert (bench.tip_m < bench.axis.lowest_m - 0.5e-3) is goes_on
    assert (bench.speed < 0) is goes_on
