"""The press as a part of a display: sensor, samples and ticks in, set-points and scaled pulse out.

Pure but for a live sensor, whose readings are taken when it has some.
"""

import math
from bisect import bisect_right
from typing import Final

from display_node.press.finger import PressingFinger
from display_node.press.finger_press import FingerPress
from display_node.press.scene import PressScene, SyntheticFingerScene
from display_node.press.sweep import DepthSweep
from display_node.scoring.beats import Beat
from protocol.summary.fields import PressFigures
from protocol.wire.messages import ChannelSamples, ProbeReport, SetPoint
from pulse_sensors.sensor import Sensor

# Samples whose hold-down is kept: at 1 kHz, 8 s.
KEPT: Final = 8_192
# A modelled hand takes this long for a step.
RISE_NS: Final = 80_000_000


class LocalPress:
    """The press of a display's first finger.

    press: random number of the display's run. target_static_n: static part of the forces that
    `scale` returned last. yielded_m: depth by which the model of the tissue
    yields. Raises nothing; a silent sensor sends nothing.
    """

    def __init__(self, scene: PressScene, press: int) -> None:
        self._scene, self._press = scene, FingerPress(scene.limits(), press)
        self._sensor: Sensor | None = None
        self._finger: PressingFinger | None = None
        self._sweep: DepthSweep | None = None
        self._table = table = scene.finger
        if table is not None:
            self._finger = PressingFinger(table.stiffness_n_per_m, table.pulse_share, table.noise_n)
        # Times of samples and their hold-down, in order.
        self._times_ns: list[int] = []
        self._hold_downs_n: list[float] = []
        self._begun_ns: int | None = None
        self._last_ns = 0
        self.target_static_n = self.yielded_m = 0.0

    def use(self, sensor: Sensor) -> None:
        """Read a live sensor. Call before the first tick."""
        self._sensor = sensor

    def sweep_with(self, sweep: DepthSweep) -> None:
        """Press as a sweep does, with no finger at the tip. Call before the first tick."""
        self._sweep = sweep

    def begin(self) -> None:
        """Begin a session, whose times are unrelated to those before; the model is kept."""
        self._times_ns.clear()
        self._hold_downs_n.clear()
        self._press.restart()
        if self._sweep is not None:
            self._sweep.restart()

    def observe(self, pulse: ChannelSamples, cell: ChannelSamples) -> ChannelSamples:
        """Learn from a frame's samples of film and load cell.

        Returns the pulse as it would be at the best hold-down, in which beats can be compared.
        """
        press = self._press
        hold_downs_n = press.observe(pulse.times_ns, pulse.forces_n, cell.forces_n)
        if self._sweep is not None:
            self._sweep.observe(pulse, hold_downs_n)
        times_ns = self._times_ns
        place = bisect_right(times_ns, pulse.times_ns[0])
        times_ns[place:place] = pulse.times_ns
        self._hold_downs_n[place:place] = hold_downs_n
        if len(times_ns) > 2 * KEPT:
            del times_ns[:KEPT], self._hold_downs_n[:KEPT]
        best = press.curve.best_height
        relative = map(press.relative, pulse.forces_n, hold_downs_n, pulse.times_ns)
        return pulse._replace(forces_n=[best * each for each in relative])

    def take_beats(self, beats: list[Beat]) -> None:
        """Take new beats of the pulse; from doubtful ones nothing is learnt."""
        for beat in beats:
            self._press.take_beat(beat.interval_s, beat.good)

    def scale(self, wrist_n: list[float], first_ns: int, step_ns: int, ratio: float) -> list[float]:
        """Return forces at the finger for forces at the wrist: press, and the pulse it would give.

        Parameters
        ----------
        wrist_n
            Pulse at the wrist, received or predicted.
        first_ns, step_ns
            Time of its first value on the sensing clock, and between values.
        ratio
            Force at the finger per force at the wrist.
        """
        if self._sweep is not None:
            # No finger presses, so the pulse is played as it is at the wrist.
            return [ratio * force_n for force_n in wrist_n]
        press, times_ns = self._press, self._times_ns
        self.target_static_n = static_n = self.static_n
        felt = []
        for number, force_n in enumerate(wrist_n):
            time_ns = first_ns + number * step_ns
            place = max(bisect_right(times_ns, time_ns) - 1, 0)
            hold_down_n = self._hold_downs_n[place] if times_ns else 0.0
            pulse_n = press.felt_n(press.relative(force_n, hold_down_n, time_ns))
            felt.append(static_n + ratio * pulse_n)
        return felt

    @property
    def unseen_n(self) -> float:
        """Static force that the film under the finger does not measure."""
        return 0.0 if self._scene.film_reads_press else self.static_n

    @property
    def press_n(self) -> float:
        """Force with which the finger presses now."""
        return self._press.press_n

    @property
    def hold_down_n(self) -> float | None:
        """Static force of the probe on the wrist, as last reported; None before a report."""
        report = self._press.sender.report
        return None if report is None else report.hold_down_n

    @property
    def still(self) -> bool:
        """True while the finger has not moved lately."""
        return self._press.still

    @property
    def static_n(self) -> float:
        """Static force of the finger now; none in a sweep, which presses in its place."""
        return self._press.static_n if self._sweep is None else 0.0

    def tick(self, now_ns: int, pulse_n: float) -> None:
        """Take the sensor's readings since the last tick; pulse_n: rendered under the finger."""
        press = self._press
        yielded_m = press.tick(now_ns)
        self.yielded_m = yielded_m if self._sweep is None else 0.0
        if self._sweep is not None:
            self._sweep.tick(now_ns, self._probe)
            press.swept_n = self._sweep.press_n
            press.read(press.swept_n, 0.0, now_ns)
        elif self._sensor is not None:
            for block in self._sensor.poll():
                for reading_n, at_ns in zip(block.force_n, block.times_ns, strict=True):
                    press.read(reading_n, pulse_n, at_ns)
        elif self._finger is not None and self._table is not None:
            elapsed_s = min(max(0, now_ns - self._last_ns) * 1e-9, 0.1) if self._last_ns else 0.0
            meant_n = self._meant_n(self._table, now_ns)
            reading_n = self._finger.step(meant_n, yielded_m, pulse_n, elapsed_s)
            press.read(reading_n, pulse_n, now_ns)
        self._last_ns = now_ns

    def request(
        self, session: int, sensing_now_ns: int, round_trip_ns: int, now_ns: int, alive: bool
    ) -> SetPoint | None:
        """Return the set-point that is due, as `FingerPress.request` does."""
        return self._press.request(session, sensing_now_ns, round_trip_ns, now_ns, alive)

    def take(self, report: ProbeReport) -> None:
        """Take an answer of the sensing node."""
        self._press.take(report)

    def figures(self) -> PressFigures:
        """Return the figures so far."""
        press, counts = self._press, self._press.sender.counts()
        return PressFigures(
            sent=counts.sent,
            applied=counts.applied,
            superseded=counts.superseded,
            lost=counts.lost,
            press_n=self.press_n,
            hold_down_n=self.hold_down_n,
            loop_gain=press.loop_gain,
            probe=self._probe,
        )

    @property
    def _probe(self) -> str | None:
        """State of the probe as last reported."""
        sender = self._press.sender
        return "held" if sender.held_by_other else sender.report.state if sender.report else None

    def _meant_n(self, table: SyntheticFingerScene, now_ns: int) -> float:
        """Return the force that the modelled finger means: its levels in turn, by soft steps."""
        if self._begun_ns is None:
            self._begun_ns = now_ns
        number, since_ns = divmod(now_ns - self._begun_ns, table.every_ns)
        levels_n = table.levels_n
        before_n = levels_n[(number - 1) % len(levels_n)] if number else 0.0
        part = 0.5 - 0.5 * math.cos(math.pi * min(1.0, since_ns / RISE_NS))
        return before_n + (levels_n[number % len(levels_n)] - before_n) * part
