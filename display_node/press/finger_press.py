"""The finger's side of the press: reading, set-points, local model and scaled pulse. Pure.

The pulse is divided by the height that the model gives for the hold-down at which it was sampled,
and multiplied by that for the present press when it is felt. So a press is felt at once, whatever
the delay, and the height at the finger does not depend on the delayed hold-down.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Final

from display_node.press.hand import FollowingHand
from display_node.press.learnt_beats import PulseHeight
from display_node.press.loop_gain import LoopGain
from display_node.press.reading import PressReading
from display_node.press.set_points import SetPointSender
from display_node.press.tissue_model import PulseCurve, StiffnessFit
from protocol.wire.messages import ProbeReport, SetPoint

# Off the wrist there is no pulse; heights below this share of the best count as that share, so
# that noise is not amplified further.
TOUCH_N: Final = 0.05
LEAST_HEIGHT: Final = 0.02
# Time over which the relative pulse's mean is taken: much more than a beat, so that a beat keeps
# its level.
MEAN_S: Final = 10.0
# Values of the relative pulse of which the time is kept, and how long a mean is used again.
BIN: Final = 0.1
BINS: Final = tuple(BIN * number for number in range(-3, 14))
MEAN_TICKS, MEAN_MOVED_N = 100, 0.005
# The tip yields with this time constant, as soft tissue does: fast enough to be felt, and slow
# enough for the stiffest finger on the softest tissue. Its speed is limited.
YIELD_S: Final = 0.25
YIELD_M_PER_S: Final = 0.02
MOST_YIELD_M: Final = 0.01
# Time after which the hold-down has a set-point that has arrived, and the reading's lag.
PROBE_S: Final = 60e-3
# A sensor without a reading for this long is silent.
SILENT_NS: Final = 50_000_000
# Without a felt sample for this long, the finger sends nothing.
BLIND_NS: Final = 300_000_000
# Longer frames are learnt in parts of this length.
LEARN_NS: Final = 5_000_000
# A beat is doubted for this time at most.
DOUBT_NS: Final = 2_000_000_000
# Frames are learnt in order, so they wait this long for earlier ones.
ORDER_NS: Final = 600_000_000


@dataclass(frozen=True, slots=True)
class PressLimits:
    """Limits at the finger.

    force_n, slew_n_per_s: of the set-point. overforce: reading, as a multiple of the force limit,
    above which nothing is sent.
    """

    force_n: float = 3.0
    slew_n_per_s: float = 20.0
    overforce: float = 3.0


class FingerPress:
    """The press of one display's finger.

    Attributes
    ----------
    press_n
        Static force of the finger.
    yielded_m
        Distance by which the tip has yielded.
    swept_n
        Force that a sweep presses with in place of the finger; None without a sweep.
    loop_gain
        Measured gain of the loop through the network, which is bounded.
    hand
        Hand that follows the tip.
    curve, stiffness
        The local model.
    sender
        Sender of the set-points.
    """

    def __init__(self, limits: PressLimits, press: int) -> None:
        self._limits = limits
        self._reading, self._gain = PressReading(), LoopGain()
        self._heights = PulseHeight()
        # Until this time nothing is learnt, as the newest beat was doubtful.
        self._doubtful_ns = -(1 << 62)
        self._read_ns: int | None = None
        self._tick_ns: int | None = None
        self._alive_ns: int | None = None
        # Frames that may still be preceded by others: time, hold-down and pulse.
        self._frames: list[tuple[int, float, float]] = []
        self._learnt_ns = self._newest_ns = -(1 << 62)
        # Mean of the relative pulse, which the static press contains already.
        self._mean, self._observed = 0.0, 0
        # Share of the time that the relative pulse spends at each of some values; from it, the mean
        # at a press, which is kept for some ticks.
        self._bins = [0.0] * len(BINS)
        self._mean_now, self._mean_at_n, self._mean_age = 0.0, math.inf, 0
        self.curve, self.stiffness = PulseCurve(limits.force_n), StiffnessFit()
        self.hand = FollowingHand()
        self.sender = SetPointSender(press, limits.force_n, limits.slew_n_per_s)
        self.yielded_m = 0.0
        self.swept_n: float | None = None

    @property
    def press_n(self) -> float:
        """Static force of the finger, within the limit."""
        press_n = self._reading.press_n if self.swept_n is None else self.swept_n
        return min(press_n, self._limits.force_n)

    @property
    def static_n(self) -> float:
        """Static force that follows the finger at once, within the limit."""
        return min(self._reading.now_n, self._limits.force_n)

    @property
    def still(self) -> bool:
        """True while the finger has not moved lately."""
        return self._reading.still

    @property
    def loop_gain(self) -> float:
        """Measured gain of the loop through the network."""
        return self._gain.gain

    @property
    def pulse_share(self) -> float:
        """Learnt share of the rendered pulse in the reading."""
        return self._reading.pulse_share

    def height_n(self, force_n: float) -> float:
        """Return the height that counts at a force, which is never next to nothing."""
        return max(self.curve.height(force_n), LEAST_HEIGHT * self.curve.best_height)

    def observe(
        self, times_ns: Sequence[int], pulse_n: Sequence[float], cell_n: Sequence[float]
    ) -> list[float]:
        """Learn from a frame of film and load cell; return the hold-down force of each sample.

        Parameters
        ----------
        times_ns
            Times of the samples.
        pulse_n, cell_n
            Channels of the film and of the load cell.
        """
        hold_downs_n = [cell - pulse for cell, pulse in zip(cell_n, pulse_n, strict=True)]
        first, longest_ns = 0, float(times_ns[0] + LEARN_NS)
        for end, time_ns in enumerate((*times_ns[1:], math.inf), 1):
            if time_ns >= longest_ns:
                part = slice(first, end)
                self._observe_part(times_ns[part], pulse_n[part], hold_downs_n[part])
                longest_ns, first = time_ns + LEARN_NS, end
        return hold_downs_n

    def _observe_part(
        self, times_ns: Sequence[int], pulse_n: Sequence[float], hold_downs_n: Sequence[float]
    ) -> None:
        """Learn from the means of a part of a frame, over which a pulse is hardly smoothed."""
        mean_n, hold_down_n = sum(pulse_n) / len(pulse_n), sum(hold_downs_n) / len(pulse_n)
        self._learn(times_ns[-1], hold_down_n, mean_n)
        if hold_down_n >= TOUCH_N:
            self._observed += 1
            part = max((times_ns[-1] - times_ns[0]) * 1e-9 / MEAN_S, 1 / self._observed)
            relative = self.relative(mean_n, hold_down_n, times_ns[-1])
            self._mean += (relative - self._mean) * part
            for at in range(len(self._bins)):
                self._bins[at] *= 1.0 - part
            place = min(max((relative - BINS[0]) / BIN, 0.0), len(BINS) - 1.001)
            at = int(place)
            self._bins[at] += part * (1.0 - place + at)
            self._bins[at + 1] += part * (place - at)

    def relative(self, pulse_n: float, hold_down_n: float, time_ns: int) -> float:
        """Return a value of the pulse relative to foot and height at its hold-down.

        A closed artery shows no diastole; respiration at that time gives it. Off the wrist there is
        no pulse: the result is its mean.
        """
        if hold_down_n < TOUCH_N:
            return self._mean
        share = pulse_n / self.height_n(hold_down_n) - self.curve.foot(hold_down_n)
        return self.curve.law.pressure(share, hold_down_n, self.curve.breath(time_ns * 1e-9))

    def restart(self) -> None:
        """Begin with times that are unrelated to those before; what was learnt is kept."""
        self._heights = PulseHeight()
        self.curve.restart()
        self._frames.clear()
        self._doubtful_ns = -(1 << 62)
        self._learnt_ns = self._newest_ns = -(1 << 62)

    def _learn(self, now_ns: int, hold_down_n: float, pulse_n: float) -> None:
        """Learn the height from the frames that no earlier one can precede any more."""
        heappush(self._frames, (now_ns, hold_down_n, pulse_n))
        self._newest_ns = max(self._newest_ns, now_ns)
        while self._newest_ns - self._frames[0][0] >= ORDER_NS:
            at_ns, mean_hold_down_n, mean_n = heappop(self._frames)
            if at_ns <= self._learnt_ns:
                continue
            self._learnt_ns = at_ns
            beat_ns = self._reading.beat_ns
            found = self._heights.add(mean_hold_down_n, mean_n, at_ns, beat_ns)
            doubtful = at_ns < self._doubtful_ns
            if found is not None and found.hold_down_n > TOUCH_N and not doubtful:
                self.curve.observe(found)

    def felt_n(self, relative: float) -> float:
        """Return the pulse in N, as the present press would give it, for its relative value."""
        press_n = min(self._reading.scaling_n, self._limits.force_n)
        if relative == self._mean:
            # Off the wrist.
            return 0.0
        share = self.curve.law.share(relative, press_n) - self._mean_share(press_n)
        return share * self.height_n(press_n)

    def _mean_share(self, press_n: float) -> float:
        """Return the mean that the pulse of the last beats would have at a press, over its height.

        It depends on the press, as the pulse flattens: that of a mean pressure is another one.
        """
        self._mean_age += 1
        if self._mean_age > MEAN_TICKS or abs(press_n - self._mean_at_n) > MEAN_MOVED_N:
            self._mean_age, self._mean_at_n = 0, press_n
            share = self.curve.law.share
            shares = [
                weight * share(at, press_n) for at, weight in zip(BINS, self._bins, strict=True)
            ]
            total = sum(self._bins)
            self._mean_now = sum(shares) / total if total else share(self._mean, press_n)
        return self._mean_now

    def take_beat(self, interval_s: float, good: bool) -> None:
        """Take the time of a new beat, over which the reading is averaged, if the beat is good.

        After a doubtful one nothing is learnt until the next good one, for some seconds at most: a
        hand that moves gives heights of its own. So do forces of which the law is wrong, where no
        beat may be found until they were learnt.
        """
        self._doubtful_ns = -(1 << 62) if good else self._newest_ns + DOUBT_NS
        if good:
            self._reading.beat_ns = round(min(max(interval_s, 0.3), 2.0) * 1e9)

    def read(self, reading_n: float, pulse_n: float, now_ns: int) -> None:
        """Take a reading of the press sensor, and the pulse that was rendered at its time."""
        if not math.isfinite(reading_n) or not math.isfinite(pulse_n):
            return
        last_ns = self._read_ns
        self._read_ns = now_ns
        self._reading.add(reading_n, pulse_n, now_ns)
        elapsed_s = 0.0 if last_ns is None else max(0, now_ns - last_ns) * 1e-9
        mean = self._reading.mean_pulse_n / self.height_n(self.press_n)
        slope = self.curve.slope(self.press_n) if self.curve.beats else 0.0
        compliance = 1 / self.stiffness.law.stiffness_n_per_m(self.press_n)
        through_hand = self.hand.most_gain(compliance, YIELD_S)
        self._gain.add(self._reading.remaining, abs(mean) + through_hand, slope, elapsed_s)

    def tick(self, now_ns: int) -> float:
        """Advance to `now_ns`, and return the distance by which the tip yields."""
        last_ns, self._tick_ns = self._tick_ns, now_ns
        elapsed_s = 0.0 if last_ns is None else max(0, now_ns - last_ns) * 1e-9
        wanted_m = min(self.stiffness.law.depth_m(self.static_n), MOST_YIELD_M)
        most_m = YIELD_M_PER_S * elapsed_s
        step_m = (wanted_m - self.yielded_m) * -math.expm1(-elapsed_s / YIELD_S)
        self.yielded_m += min(max(step_m, -most_m), most_m)
        self.hand.observe(self.static_n, self.yielded_m, now_ns)
        return self.yielded_m

    def request(
        self, session: int, sensing_now_ns: int, round_trip_ns: int, now_ns: int, alive: bool
    ) -> SetPoint | None:
        """Return the set-point that is due, if any; none while the finger cannot feel the wrist.

        alive: whether the stream is felt now. Without it, or without readings, the wrist eases off.
        """
        if alive:
            self._alive_ns = now_ns
        silent = self._read_ns is None or now_ns - self._read_ns > SILENT_NS
        blind = self._alive_ns is None or now_ns - self._alive_ns > BLIND_NS
        beyond = self._reading.press_n > self._limits.overforce * self._limits.force_n
        if silent or beyond or blind:
            return None
        ahead_s = 0.5e-9 * round_trip_ns + PROBE_S
        wanted_n = self.press_n + self.hand.change_n(
            self.press_n, self.stiffness.law, YIELD_S, ahead_s
        )
        bounded_n = self._gain.bound(wanted_n)
        return self.sender.due(bounded_n, session, sensing_now_ns, round_trip_ns, now_ns)

    def take(self, report: ProbeReport) -> None:
        """Take an answer of the sensing node, and learn the tissue's stiffness from it."""
        if self.sender.take(report):
            self.stiffness.observe(report.hold_down_n, report.depth_m)
