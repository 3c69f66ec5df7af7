"""A probe on a supervised drive over an emulated wrist, in virtual time."""

from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from protocol.errors import SourceError
from protocol.faults import FaultKind
from protocol.tissue import StiffeningLaw
from protocol.wire.description import Channel
from pulse_drives import build_drive
from pulse_drives.scene import MotorScene, TmclScene
from pulse_sensors.samples import SampleBlock
from sensing_node.press.live_probe import (
    KEPT,
    PATIENCE_NS,
    JoinedSensors,
    LiveProbe,
    columns_of,
)
from sensing_node.press.probe import ProbeLimits
from sensing_node.sources.wrist import WristScene, WristSensors
from telepulse.emulators.motor import EmulatedMotor, MotorState
from telepulse.emulators.wrist import TissueContact, read_wrist
from tests.support.drive_benches import stepper
from tests.support.fault_injection import FaultyMotor
from tests.support.virtual_lines import virtual_line
from tests.support.virtual_time import VirtualTime

MS = 1_000_000
FRAME = 4
LIMITS = ProbeLimits(max_speed="30 mm/s", travel="14 mm")
DRIVE = TmclScene.model_validate({"kind": "tmcl", "port": "x", "touch": "5 mm"})
VIRTUAL = ("sensing_node.press",)


class VirtualBoard:
    """Film and load cell of a wrist, delivered some milliseconds late in frames of four."""

    channels, period_ns = WristSensors.channels, MS

    def __init__(
        self, world: VirtualTime, motor: EmulatedMotor, wrist: WristScene, late_ms: int
    ) -> None:
        self._world, self._motor, self._sensors = world, motor, WristSensors(wrist)
        self._late_ns = late_ms * MS
        self._blocks: list[SampleBlock] = []
        self.silent = False
        self.cell_n: float | None = None
        self.rejected: Counter[str] = Counter()
        world.every(FRAME * MS, self._take)

    def _take(self) -> None:
        """Sample the forces of the last four milliseconds."""
        now_ns = self._world.now_ns
        self._motor.advance(now_ns)
        forces_n = [self._motor.forces_n.popleft() for _ in range(FRAME)]
        values = np.array(read_wrist(self._sensors, forces_n))
        if self.cell_n is not None:
            values[:, 1] = self.cell_n
        self._blocks.append(SampleBlock(values, 0, now_ns - (FRAME - 1) * MS, now_ns + MS))

    def poll(self) -> list[SampleBlock]:
        due_ns = self._world.now_ns - self._late_ns
        due = [block for block in self._blocks if block.end_ns - MS <= due_ns]
        self._blocks = self._blocks[len(due) :]
        return [] if self.silent else due

    def faults(self) -> list[str]:
        return []

    def close(self) -> None:
        """Have nothing to close."""


class PressedBench:
    """A probe on an emulated drive over a wrist; force_n: the true force, one a millisecond."""

    def __init__(
        self, world: VirtualTime, motor: EmulatedMotor, board: VirtualBoard, probe: LiveProbe
    ) -> None:
        self.world, self.motor, self.board, self.probe = world, motor, board, probe
        self.moments: list[MotorState] = []
        motor.trace = self.moments.append

    def run(self, ms: int, set_point_n: float | None = None) -> None:
        for _ in range(0, ms, 20):
            if set_point_n is not None:
                self.probe.press(set_point_n)
            self.world.run(self.world.now_ns + 20 * MS)

    def hang(self, ms: int) -> None:
        """Let the probe's own thread hang."""
        threads = [thread for thread in self.world.threads if thread.name == "probe"]
        self.world.stall(threads, self.world.now_ns + ms * MS)
        self.run(ms)

    @property
    def force_n(self) -> NDArray[np.float64]:
        return np.array([moment.force_n for moment in self.moments])


@contextmanager
def pressed(stiffness: float = 1.0, late_ms: int = 4) -> Iterator[PressedBench]:
    """Provide a probe at rest, off the wrist."""
    length_m = StiffeningLaw(length_m=1.2e-3 / stiffness).length_m
    wrist = WristScene.model_validate({"kind": "wrist", "length": f"{length_m} m"})
    world = VirtualTime()
    motor = FaultyMotor(stepper(), TissueContact(wrist), DRIVE.touch_m, world.now_ns)
    with virtual_line(world, DRIVE, motor, VIRTUAL):
        board = VirtualBoard(world, motor, wrist, late_ms)
        drive = build_drive(DRIVE, MotorScene(), LIMITS.travel_m)
        probe = LiveProbe(LIMITS, drive, board, world.perf_counter_ns)
        probe.start()
        yield PressedBench(world, motor, board, probe)


@pytest.mark.parametrize("late_ms", [2, 16])
@pytest.mark.parametrize("stiffness", [0.3, 1.0, 3.0])
def test_set_points_are_followed_by_a_supervised_drive_without_swinging(
    stiffness: float, late_ms: int
) -> None:
    with pressed(stiffness, late_ms) as bench:
        bench.run(1_500, 0.6)
        assert bench.probe.state == "pressing"
        for wanted_n in (1.5, 0.5, 2.5):
            bench.run(1_500, wanted_n)
            forces_n = bench.force_n
            assert np.abs(forces_n[-1_000:] / wanted_n - 1).max() < 0.05
        assert bench.force_n.max() <= LIMITS.force_limit_n
        # Over 5 ms, as the drive moves in whole microsteps.
        assert np.abs(np.diff(bench.force_n[::5])).max() / 5e-3 < LIMITS.slew_limit_n_per_s
        assert bench.probe.depth_m == pytest.approx(
            StiffeningLaw(length_m=1.2e-3 / stiffness).depth_m(2.5), rel=0.2
        )
        assert not bench.probe.probe.faults


def silence(bench: PressedBench) -> None:
    bench.board.silent = True


def stop_motor(bench: PressedBench) -> None:
    bench.motor.fail("overtemperature")


def freeze_cell(bench: PressedBench) -> None:
    bench.board.cell_n = 0.0


@pytest.mark.parametrize(
    ("happens", "fault", "follows"),
    [
        (silence, "load cell: silent", True),
        (freeze_cell, "load cell: 0 mN unchanged", True),
        (stop_motor, "drive: fault: overtemperature", False),
    ],
)
def test_after_a_fault_the_probe_leaves_the_wrist(
    happens: Callable[[PressedBench], None], fault: str, follows: bool
) -> None:
    with pressed() as bench:
        bench.run(1_500, 1.5)
        pressed_ms = len(bench.moments)
        happens(bench)
        bench.run(1_000, 1.5)
    assert fault in str(bench.probe.probe.faults[0])
    assert bench.probe.state == "fault"
    assert bench.force_n[pressed_ms:].max() < LIMITS.force_limit_n * LIMITS.overforce
    # A motor that stops itself leaves the probe where it is.
    assert bool(bench.force_n[-1] == 0) is follows


def test_a_loop_that_hangs_leaves_the_withdrawal_to_the_drives_thread() -> None:
    with pressed() as bench:
        bench.run(1_500, 1.5)
        bench.hang(1_000)
        assert bench.force_n[-1] == 0
        bench.run(20)
    assert bench.probe.probe.faults[0].kind is FaultKind.NO_COMMAND


def test_a_load_cell_that_is_frozen_before_the_wrist_is_found_before_it_presses() -> None:
    with pressed() as bench:
        bench.board.cell_n = 0.01
        bench.run(2_000, 1.5)
    assert bench.probe.probe.faults[0].kind is FaultKind.FROZEN
    assert bench.force_n.max() == 0


def test_a_source_without_a_load_cell_is_refused() -> None:
    with pytest.raises(SourceError, match=r"add \[sensing.press.sensor\]"):
        columns_of((Channel("pulse"),))


class Blocks:
    """A sensor whose blocks a test queues."""

    period_ns = MS

    def __init__(self, name: str) -> None:
        self.channels = (Channel(name),)
        self.rejected: Counter[str] = Counter()
        self.waiting: list[SampleBlock] = []

    def add(self, first_ms: int, values: list[float], period_ms: int = 1) -> None:
        end_ms = first_ms + period_ms * len(values)
        block = SampleBlock(np.array(values)[:, None], 0, first_ms * MS, end_ms * MS)
        self.waiting.append(block)

    def poll(self) -> list[SampleBlock]:
        found, self.waiting = self.waiting, []
        return found


def test_each_sample_of_the_film_gets_the_load_cells_force_at_its_time() -> None:
    film, cell = Blocks("pulse"), Blocks("force")
    joined = JoinedSensors(film, cell)
    assert [channel.name for channel in joined.channels] == ["pulse", "hold-down"]
    cell.add(0, [0.0, 1.0, 2.0], period_ms=10)
    film.add(3, [0.5, 0.6])
    film.add(19, [0.7, 0.8, 0.9])
    (block,) = joined.poll()
    assert block.values == pytest.approx(np.array([[0.5, 0.3], [0.6, 0.4]]))
    assert joined.poll() == []
    # Without a force, samples count as missing.
    film.add(PATIENCE_NS // MS + 30, [1.0])
    assert joined.poll() == []
    assert joined.rejected == {"without_load_cell": 3}
    cell.add(30, [3.0] * 20, period_ms=10)
    (block,) = joined.poll()
    assert block.missing == 3


def test_a_block_is_joined_from_the_forces_around_it_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    interpolated: list[int] = []
    interp = np.interp

    def counted(times: Any, known: Any, forces: Any) -> Any:
        interpolated.append(len(known))
        return interp(times, known, forces)

    monkeypatch.setattr("sensing_node.press.live_probe.np.interp", counted)
    film, cell, joined_n = Blocks("pulse"), Blocks("force"), []
    joined = JoinedSensors(film, cell)
    # Times of a host that has run for months, at which a float counts in steps of 2 ns.
    began_ms, forces_n = 12_000_000_000, np.sin(np.arange(20_000) / 100).tolist()
    for first in range(0, len(forces_n), 5):
        cell.add(began_ms + first, forces_n[first : first + 5])
        # The film is silent for longer than the load cell's samples are kept.
        if first % 10 == 0 and not 4_000 <= first < 4_000 + 9_000:
            film.add(began_ms + first, [0.1, 0.2, 0.3, 0.4])
        joined_n += [values for block in joined.poll() for values in block.values[:, 1].tolist()]
    expected = [
        force_n
        for first in range(0, len(forces_n), 10)
        if not 4_000 <= first < 4_000 + 9_000
        for force_n in forces_n[first : first + 4]
    ]
    assert joined_n == pytest.approx(expected, abs=1e-9)
    assert max(interpolated) <= 10
    assert joined.rejected == {}


def test_forces_that_are_older_than_what_is_kept_are_not_used() -> None:
    film, cell = Blocks("pulse"), Blocks("force")
    joined = JoinedSensors(film, cell)
    cell.add(0, [1.0] * KEPT)
    cell.add(KEPT, [2.0] * 10)
    film.add(5, [0.5])
    film.add(PATIENCE_NS // MS + 100, [0.6])
    (block,) = joined.poll()
    assert block.values.tolist() == [[0.6, 1.0]]
    assert joined.rejected == {"without_load_cell": 1}
