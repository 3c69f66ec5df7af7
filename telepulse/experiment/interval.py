"""An interval of a trial: the pulse is felt while a gate in the display's safety is open.

The stream runs to the display over a link, or directly. The actuator rests while the gate is
closed. The force ramps up when the gate opens, and fades when it closes, as for a stream that
begins and ends. Only the display's clock moves the gate, so the beginning of the pulse reveals
neither the link's delay nor the time to join.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from random import Random

from pydantic import BaseModel, ConfigDict

from display_node.display import Display
from display_node.hardware import Hardware
from display_node.scoring.deadlines import GAP_NS
from telepulse.experiment.session import Letter, SessionPlan, Trial
from telepulse.scene import Scene
from telepulse.simulation.virtual_time import Simulation

# The gate opens after a random time up to this. It is longer than a beat, so that the pulse can
# begin at any phase.
FOREPERIOD_NS = 1_000_000_000
# Time from the end of the fade until the layer is at rest.
REST_NS = 150_000_000
# An interval with a larger share of missed ticks does not represent its condition.
MOST_MISSED = 0.01


@dataclass(frozen=True, slots=True)
class Interval:
    """An interval to be felt. foreperiod_ns: time from its start until the gate opens."""

    letter: Letter
    scene: Scene
    on_link: bool
    link_seed: int
    foreperiod_ns: int
    felt_ns: int


class PlayedInterval(BaseModel):
    """The record of an interval in the log.

    Attributes
    ----------
    felt_s : float
        Time at full strength.
    aligned_n, in_phase_n : float or None
        Force RMSE against the pulse at the instant that is played, and at the present.
    pulse_n : float
        Reference pulse from peak to peak.
    ticks : int
        Ticks of the whole interval, missed ones included.
    stale_ticks : int
        Ticks with the gate open and a stale stream.
    longest_gap_ms : float
        Longest time between two ticks.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    letter: Letter
    on_link: bool
    link_seed: int
    foreperiod_s: float
    felt_s: float
    aligned_n: float | None
    in_phase_n: float | None
    roughness_felt_n: float | None
    roughness_sensed_n: float | None
    pulse_n: float
    deadline_misses: int
    ticks: int
    stale_ticks: int
    longest_gap_ms: float

    @property
    def stale(self) -> str:
        """Reason why the pulse was not fully felt, a stale stream or no full strength; or ""."""
        if self.stale_ticks:
            percent = 100 * self.stale_ticks / self.ticks
            return f"the stream stale for {percent:.1f} % of the ticks"
        return "" if self.felt_s else "never felt at full strength"

    @property
    def spoilt(self) -> str:
        """Reason why the machine spoilt the interval, or "".

        A stale stream is an effect of the link model, which is under test and does not depend on
        the machine. A slow machine shows as missed ticks.
        """
        if self.deadline_misses > MOST_MISSED * self.ticks:
            return f"{100 * self.deadline_misses / self.ticks:.1f} % of the ticks missed"
        if self.longest_gap_ms > GAP_NS * 1e-6:
            return f"no tick for {self.longest_gap_ms:.0f} ms"
        return "" if self.on_link else self.stale


def draw_interval(
    plan: SessionPlan, seed: int, index: int, trial: Trial, letter: Letter, nth: int
) -> Interval:
    """Return the nth playing of a letter in a trial.

    All letters of a trial have the same beats. The link's random numbers and the foreperiod are
    drawn anew for each playing, so that X is never identical to A or B.
    """
    random = Random(f"interval {seed} {index} {letter} {nth}")
    on_link = trial.on_link(letter)
    scene = plan.impaired[trial.condition] if on_link and trial.condition else plan.direct
    source = scene.sensing.modelled.with_seed(trial.pulse_seed)
    session = plan.session
    return Interval(
        letter=letter,
        scene=replace(scene, sensing=scene.sensing.model_copy(update={"source": source})),
        on_link=on_link,
        link_seed=random.getrandbits(31),
        foreperiod_ns=session.joining_ns + session.settle_ns + random.randrange(FOREPERIOD_NS),
        felt_ns=scene.display.safety.ramp_ns + session.interval_ns,
    )


class IntervalPlayback:
    """An interval that is being felt. Pure: the caller provides the clock and the bench.

    Raises SceneError or SourceError.
    """

    def __init__(self, interval: Interval, begin_ns: int, hardware: Hardware | None = None) -> None:
        scene = interval.scene.display
        self._interval = interval
        self._simulation = Simulation(interval.scene, interval.link_seed, begin_ns, hardware)
        self._fade = self._simulation.display.fade
        self._tick_ns = scene.tick_ns
        self._open_ns = begin_ns + interval.foreperiod_ns
        self._close_ns = self._open_ns + interval.felt_ns
        self._rest_ns = scene.safety.fade_ns + REST_NS
        self._simulation.begin((self._close_ns + self._rest_ns - begin_ns) * 1e-9)
        self._all_ticks, self._longest_ticks, self._felt_ticks = 0, 1, 0
        self._stale_ticks = 0
        self._least_n, self._most_n = math.inf, -math.inf
        self.deadline_misses = 0

    @property
    def display(self) -> Display:
        """The display that plays the interval."""
        return self._simulation.display

    def tick(self, now_ns: int, elapsed_ticks: int = 1) -> bool:
        """Tick the display; return False once the interval is over and the actuator at rest."""
        self.deadline_misses += elapsed_ticks - 1
        self._all_ticks += elapsed_ticks
        self._longest_ticks = max(self._longest_ticks, elapsed_ticks)
        is_open = self._open_ns <= now_ns < self._close_ns
        self._fade.held = not is_open
        state = self._simulation.tick(now_ns, elapsed_ticks)
        self._stale_ticks += is_open and not self._fade.alive
        if state.full:
            self._felt_ticks += elapsed_ticks
            self._least_n = min(self._least_n, state.target_n)
            self._most_n = max(self._most_n, state.target_n)
        return now_ns < self._close_ns + self._rest_ns

    def stop(self, now_ns: int) -> None:
        """Close the gate now."""
        self._close_ns = min(self._close_ns, now_ns)

    def played(self) -> PlayedInterval:
        """Return the record of this interval."""
        summary, interval = self._simulation.end(), self._interval
        force, rough = summary.force_rmse_n, summary.roughness
        return PlayedInterval(
            letter=interval.letter,
            on_link=interval.on_link,
            link_seed=interval.link_seed,
            foreperiod_s=interval.foreperiod_ns * 1e-9,
            felt_s=self._felt_ticks * self._tick_ns * 1e-9,
            aligned_n=force.aligned,
            in_phase_n=force.in_phase,
            roughness_felt_n=rough.felt_n,
            roughness_sensed_n=rough.sensed_n,
            pulse_n=max(0.0, self._most_n - self._least_n),
            deadline_misses=self.deadline_misses,
            ticks=self._all_ticks,
            stale_ticks=self._stale_ticks,
            longest_gap_ms=self._longest_ticks * self._tick_ns * 1e-6,
        )


def play_in_virtual_time(interval: Interval) -> PlayedInterval:
    """Play an interval on the scene's models in virtual time, whatever drive the scene has.

    Raises SceneError or SourceError.
    """
    display = interval.scene.display.model_copy(update={"drive": None, "feedback": None})
    interval = replace(interval, scene=replace(interval.scene, display=display))
    playing, now_ns = IntervalPlayback(interval, 0), 0
    while playing.tick(now_ns):
        now_ns += display.tick_ns
    return playing.played()


def interval_errors(played: Sequence[PlayedInterval]) -> tuple[float, float, float]:
    """Return the mean aligned force errors of A, B and X over the direct pulse from peak to peak.

    An interval that was never felt at full strength counts as 1. NaN for a letter without any
    interval.
    """
    pulse_n = max((p.pulse_n for p in played if not p.on_link), default=0.0)

    def share(letter: str) -> float:
        errors_n = [p.aligned_n for p in played if p.letter == letter and pulse_n > 0]
        shares = [1.0 if error_n is None else error_n / pulse_n for error_n in errors_n]
        return sum(shares) / len(shares) if shares else math.nan

    return share("A"), share("B"), share("X")
