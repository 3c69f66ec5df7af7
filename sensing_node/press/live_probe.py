"""A probe on a real drive: a thread that reads film and load cell, and steps the force loop.

The thread is apart from the node's, so that neither displays nor a slow disk delay the loop. If it
stops, the drive's own watchdog stops the motor, and the drive's supervision withdraws the probe.
"""

import logging
import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.errors import SourceError
from protocol.faults import Fault, FaultKind, Part, internal_fault
from protocol.host.guard import GuardedThread
from protocol.host.output import FAULT
from protocol.wire.description import HOLD_DOWN, Channel
from pulse_drives.drive import Drive
from pulse_drives.start_advice import advised
from pulse_drives.supervisor import FILM_IS_WRONG
from pulse_sensors.samples import SampleBlock
from pulse_sensors.sensor import Sensor
from sensing_node.press.probe import TOUCH_N, Probe, ProbeLimits
from sensing_node.press.set_points import PressedProbe

logger = logging.getLogger(__name__)

DRIVE_TABLE: Final = "[sensing.press.drive]"
PERIOD_S: Final = 2e-3
FIRST_SAMPLE_WITHIN_S: Final = 5.0
# A step of the loop waits for nothing.
LOOP_ENDS_WITHIN_S: Final = 1.0
# The load cell's zero is the mean over this time, off the wrist.
ZERO_S: Final = 0.2
# Blocks that wait for the node's thread: some seconds of any sensor.
MOST_BLOCKS: Final = 4_096
# A load cell that reads exactly the same over this travel is frozen: one that works has noise in
# its last digit. Less where the wrist was pressed just before, and a broken one reads 0 now.
FROZEN_M: Final = 0.5e-3
FROZEN_PRESSED_M: Final = 0.1e-3
# The film's samples wait this long for the load cell's.
PATIENCE_NS: Final = 100_000_000
# Samples of the load cell that are kept: some seconds of any.
KEPT: Final = 8_192


class CellForces:
    """A load cell's newest forces in N, for times that rise from call to call."""

    def __init__(self) -> None:
        # The samples from `_begin` to `_end` are kept. They move to the front once in `KEPT`.
        self._times_ns = np.empty(2 * KEPT, np.int64)
        self._forces_n = np.empty(2 * KEPT)
        self._begin = self._end = 0

    def add(self, block: SampleBlock) -> None:
        """Add the newest samples; the oldest are dropped."""
        times_ns, forces_n = block.times_ns[-KEPT:], block.values[-KEPT:, 0]
        if self._end + len(times_ns) > len(self._times_ns):
            kept = slice(max(self._begin, self._end - KEPT), self._end)
            self._begin, self._end = 0, kept.stop - kept.start
            for array in (self._times_ns, self._forces_n):
                array[: self._end] = array[kept]
        added = slice(self._end, self._end + len(times_ns))
        self._times_ns[added], self._forces_n[added] = times_ns, forces_n
        self._end = added.stop
        self._begin = max(self._begin, self._end - KEPT)

    def at(self, times_ns: list[int]) -> NDArray[np.float64] | None:
        """Return the forces at rising times; None where no samples are around them."""
        known_ns = self._times_ns[self._begin : self._end]
        if not len(known_ns) or not known_ns[0] <= times_ns[0] <= times_ns[-1] <= known_ns[-1]:
            return None
        first = self._begin + int(known_ns.searchsorted(times_ns[0], "right")) - 1
        last = self._begin + int(known_ns.searchsorted(times_ns[-1], "left")) + 1
        # Later calls need none from before.
        self._begin = first
        origin_ns = self._times_ns[first]
        forces_n: NDArray[np.float64] = np.interp(
            np.array(times_ns) - origin_ns,
            self._times_ns[first:last] - origin_ns,
            self._forces_n[first:last],
        )
        return forces_n


class JoinedSensors:
    """A film's samples, each with the load cell's force at its time.

    Both must have the same delay, as a pulse belongs to the hold-down that is measured with it.
    Samples for which no force comes count as missing, and in `rejected`.
    """

    def __init__(self, film: Sensor, cell: Sensor) -> None:
        self.channels = (*film.channels, Channel(HOLD_DOWN))
        self.period_ns = film.period_ns
        self._film, self._cell = film, cell
        self._waiting: deque[SampleBlock] = deque()
        self._cell_forces = CellForces()
        self._missing = self._alone = 0

    def poll(self) -> list[SampleBlock]:
        """Return the film's samples for which the load cell's force has arrived."""
        for block in self._cell.poll():
            self._cell_forces.add(block)
        self._waiting.extend(self._film.poll())
        joined = []
        while self._waiting:
            block = self._waiting[0]
            forces_n = self._cell_forces.at(block.times_ns)
            if forces_n is not None:
                values = np.column_stack([block.values, forces_n])
                missing = block.missing + self._missing
                joined.append(block._replace(values=values, missing=missing))
                self._missing = 0
            elif self._waiting[-1].end_ns - block.end_ns < PATIENCE_NS:
                break
            else:
                self._missing += len(block.values) + block.missing
                self._alone += len(block.values)
            self._waiting.popleft()
        return joined

    @property
    def rejected(self) -> Counter[str]:
        """Count of data that could not be used, by cause."""
        alone = Counter(without_load_cell=self._alone)
        return +(self._film.rejected + self._cell.rejected + alone)

    def faults(self) -> list[str]:
        """Return the faults of both, one line each."""
        return [*self._film.faults(), *self._cell.faults()]

    def close(self) -> None:
        """Release both devices."""
        self._film.close()
        self._cell.close()


SampleSensor = Sensor | JoinedSensors


class Reading(NamedTuple):
    """A sample of both sensors in N, and its time."""

    taken_ns: int
    film_n: float
    cell_n: float


class FrozenCell:
    """Check for a load cell whose reading stays exactly the same while the drive moves."""

    def __init__(self) -> None:
        self._cell_n = math.nan
        self._low_m = self._high_m = 0.0
        # Where the wrist was pressed last.
        self._pressed_m = math.inf

    def check(self, cell_n: float, position_m: float, now_ns: int) -> Fault | None:
        """Take a reading and the position at its time; return the fault, if it is one."""
        if cell_n != self._cell_n:
            self._cell_n, self._low_m, self._high_m = cell_n, position_m, position_m
        self._low_m, self._high_m = min(self._low_m, position_m), max(self._high_m, position_m)
        if cell_n >= TOUCH_N:
            self._pressed_m = position_m
        travel_m = self._high_m - self._low_m
        beyond = position_m >= self._pressed_m
        if travel_m <= (FROZEN_PRESSED_M if beyond else FROZEN_M):
            return None
        cause = f"{cell_n * 1e3:.0f} mN unchanged over {travel_m * 1e3:.1f} mm of travel"
        return Fault(FaultKind.FROZEN, Part.LOAD_CELL, cause, now_ns)


class LiveProbe(PressedProbe):
    """A probe: its force loop, its drive, and its sensors, whose samples are the stream.

    sensor: of film and load cell. clock: the host's, in ns. Positions are 0 where the probe rests,
    off the wrist, `touch` from the drive's home.
    """

    def __init__(
        self,
        limits: ProbeLimits,
        drive: Drive,
        sensor: SampleSensor,
        clock: Callable[[], int] = time.perf_counter_ns,
    ) -> None:
        self.channels, self.period_ns = sensor.channels, sensor.period_ns
        self._drive, self._sensor, self._clock = drive, sensor, clock
        self._film_at, self._cell_at = columns_of(sensor.channels)
        self._limits, self.probe = limits, Probe(limits)
        self._frozen = FrozenCell()
        self._lock = threading.Lock()
        self._blocks: deque[SampleBlock] = deque(maxlen=MOST_BLOCKS)
        self._newest: Reading | None = None
        self._position_m = self._touched_m = 0.0
        self._named = 0
        self._started = False
        self._thread = GuardedThread("probe", self._run_once, self._on_error)
        self.dropped = 0

    @property
    def depth_m(self) -> float:
        """Travel of the probe since it has touched the wrist; 0 off the wrist."""
        return self._position_m - self._touched_m

    def press(self, force_n: float) -> None:
        """Take a set-point in N."""
        with self._lock:
            self.probe.press(force_n, self._clock())

    def start(self) -> None:
        """Wait for the first sample, bring the drive to its rest and follow set-points; blocks.

        Raises SourceError where no sample comes, or the load cell is loaded off the wrist.
        Raises DriveError.
        """
        deadline_s = time.monotonic() + FIRST_SAMPLE_WITHIN_S
        while self._read() is None:
            if time.monotonic() > deadline_s:
                raise SourceError(
                    f"[sensing.press] no sample of film and load cell within"
                    f" {FIRST_SAMPLE_WITHIN_S:g} s: check that the sensors are the right ones, and"
                    " on"
                )
            time.sleep(PERIOD_S)
        logger.warning("the probe's drive looks for its home: keep the wrist away")
        with advised(DRIVE_TABLE):
            self._drive.start(self._cell_n)
        self._check_zero()
        self._blocks.clear()
        self._thread.start()
        self._started = True
        logger.info("the probe is at rest, off the wrist")

    def poll(self) -> list[SampleBlock]:
        """Return the samples since the last call. Never waits."""
        blocks = []
        while self._blocks:
            blocks.append(self._blocks.popleft())
        return blocks

    @property
    def rejected(self) -> Counter[str]:
        """Count of data that could not be used, by cause, of sensors and drive."""
        counts = Counter({f"drive {name}": n for name, n in self._drive.counts.items()})
        counts.pop("drive superseded", None)
        counts["backlog"] += self.dropped
        return +(counts + self._sensor.rejected)

    def faults(self) -> list[str]:
        """Return the faults of the sensors, which latch nothing, one line each."""
        return self._sensor.faults()

    def leave(self) -> None:
        """Take the probe off the wrist; one that may still press it then has a fault.

        Waits as long as the withdrawal may take.
        """
        if not self._started:
            return
        self._started = False
        if not self._thread.stop(LOOP_ENDS_WITHIN_S):
            logger.error("the probe's loop hangs")
        self._drive.withdraw()
        if (fault := self._drive.await_withdrawal(self._read)) is not None:
            self.probe.fault(fault)
            self._log_faults()

    def close(self) -> None:
        """Take the probe off the wrist, bring the drive to rest, and close drive and sensors."""
        self.leave()
        self._drive.close()
        self._sensor.close()

    def _run_once(self) -> None:
        time.sleep(PERIOD_S)
        self.step(self._clock())

    def _on_error(self, error: BaseException) -> None:
        """Latch an exception of the loop, and withdraw: the loop goes on."""
        fault = internal_fault(Part.PROBE, "probe", error, self._clock())
        self.probe.fault(fault)
        self._drive.withdraw(fault)
        self._log_faults()

    def step(self, now_ns: int) -> None:
        """Read the sensors, and command the drive; the thread calls it every 2 ms."""
        probe, drive, reading = self.probe, self._drive, self._read()
        status = drive.status()
        with self._lock:
            if status.fault is not None and not probe.faults:
                probe.fault(status.fault)
            position_m = self._position_m
            if reading is not None:
                position_m = drive.commanded_m(reading.taken_ns)
                if now_ns - reading.taken_ns > self._limits.cell_within_ns:
                    reading = None
                elif not probe.faults:
                    frozen = self._frozen.check(reading.cell_n, position_m, now_ns)
                    if frozen is not None:
                        probe.fault(frozen)
            if probe.hold_down_n < TOUCH_N:
                self._touched_m = position_m
            self._position_m = position_m
            cell_n, film_n = (None, 0.0) if reading is None else (reading.cell_n, reading.film_n)
            age_ns = 0 if self._newest is None else max(0, now_ns - self._newest.taken_ns)
            speed_m_per_s = probe.step(cell_n, film_n, position_m, now_ns, age_ns)
        if probe.faults:
            wrong = any(f.part is Part.LOAD_CELL and f.kind in FILM_IS_WRONG for f in probe.faults)
            drive.withdraw(probe.faults[0], film_trusted=not wrong)
        else:
            drive.command(speed_m_per_s)
        self._log_faults()

    def _log_faults(self) -> None:
        for fault in self.probe.faults[self._named :]:
            logger.error(
                f"the probe leaves the wrist: {fault}: {fault.remedy}", extra={FAULT: True}
            )
        self._named = len(self.probe.faults)

    def _read(self) -> Reading | None:
        """Take the new samples; return the newest one, None without any."""
        newest = None
        for block in self._sensor.poll():
            self.dropped += len(block.values) * (len(self._blocks) == MOST_BLOCKS)
            self._blocks.append(block)
            values = block.values[-1]
            newest = Reading(
                block.times_ns[-1], float(values[self._film_at]), float(values[self._cell_at])
            )
        if newest is not None:
            self._newest = newest
            self._drive.add_force_reading(newest.cell_n, newest.taken_ns)
        return newest

    def _cell_n(self) -> float | None:
        """Return the newest reading of the load cell."""
        self._read()
        return None if self._newest is None else self._newest.cell_n

    def _check_zero(self) -> None:
        """Raise SourceError if the load cell reads a force where nothing presses it."""
        readings, until_s = [], time.monotonic() + ZERO_S
        while time.monotonic() < until_s:
            self._drive.command(0.0)
            if (reading := self._read()) is not None:
                readings.append(reading.cell_n - reading.film_n)
            time.sleep(PERIOD_S)
        mean_n = sum(readings) / len(readings) if readings else math.nan
        if not abs(mean_n) < TOUCH_N:
            raise SourceError(
                f"[sensing.press] the load cell reads {mean_n * 1e3:.0f} mN off the wrist: set its"
                " zero, or a smaller `touch` of the drive where the wrist is nearer"
            )


def columns_of(channels: tuple[Channel, ...]) -> tuple[int, int]:
    """Return the columns of film and load cell. Raises SourceError where one is missing."""
    names = [channel.name for channel in channels]
    films = [at for at, each in enumerate(channels) if each.unit == "N" and each.name != HOLD_DOWN]
    if HOLD_DOWN not in names or not films:
        raise SourceError(
            f"[sensing.press] the source has the channels {', '.join(names)}: a film and"
            f' "{HOLD_DOWN}", the load cell, are needed; name the latter in `names`, or add'
            " [sensing.press.sensor]"
        )
    return films[0], names.index(HOLD_DOWN)
