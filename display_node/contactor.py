"""One contactor of a display: a channel of the stream, played on one actuator. Pure.

The display decides which instant is played, for all contactors; each contactor predicts what has
not arrived of its channel, scales it to its finger and runs its own force loop.
"""

import math
from collections import deque

from display_node.control.safety import ForceBounds, Safety
from display_node.fault_advice import FILM_NOTE
from display_node.hardware import Hardware
from display_node.plant.feedback import Feedback
from display_node.plant.filters import delay_line
from display_node.prediction import Linear, Predictor
from display_node.prediction.concealment import Concealment
from display_node.press.local_press import LocalPress
from display_node.press.yielding_tip import YieldingTip
from display_node.scene import DisplayScene
from display_node.scoring.beat_statistics import BeatStatistics
from display_node.scoring.prediction_score import PredictionScore
from display_node.scoring.tracking_error import TrackingError
from protocol.summary.tables import Compensation, Limits, Loop, SampleCounts, Summary
from protocol.tactile import matching_force_ratio
from protocol.ticks import LimitCounter, TickState
from protocol.wire.description import StreamDescription
from protocol.wire.messages import ChannelSamples
from protocol.wire.telemetry import PlaybackStatus
from pulse_drives.withdrawal import FingerState, describe_finger

# Frames that wait for the slack to be scored; beyond, the oldest is scored at once.
MOST_UNSCORED = 64


class Contactor:
    """A contactor and the state of its channel.

    Parameters
    ----------
    scene
        The display's settings with those of this contactor.
    score
        Whether to compute the running errors of the felt force against the received one.
    prefix
        Text before the names of this contactor's faults.

    Attributes
    ----------
    feedback
        Readings of a real film, which replace those of the scene's models.
    count
        Number of values of the reference, one a tick: the present one and the loop's horizon.
    force_ratio
        Force at the finger per force at the wrist that makes both strains equal.
    lead_ns
        Time by which the sample that is played is later than the played instant of the pulse: the
        group delay of the sensing chain, and the lag of the actuator.
    reach_ns
        Time by which the last sample that the loop requires is later: to the end of its horizon.
    reserve_ns
        The delay that "auto" adds for the loop: to the sample after the end of its horizon.
    press
        The finger's press, which scales the pulse; None where it is not sent to the wrist.
    state
        State of the last tick.
    """

    def __init__(self, scene: DisplayScene, score: bool, prefix: str = "") -> None:
        self._prefix = prefix
        self.scene, self.name = scene, scene.shown_name
        self.feedback: Feedback | None = None
        self.layer = scene.layer.layer()
        self.state = TickState()
        self.force_ratio = 1.0
        self.lead_ns = self.reach_ns = self.reserve_ns = 0
        self.bounds = ForceBounds(scene.safety, scene.tick_ns)
        self.loop = scene.force_loop()
        self.tracking_error = TrackingError(self.layer.strain_per_newton) if score else None
        self.press: LocalPress | None = None
        self._hardware: Hardware | None = None
        self._tip: YieldingTip | None = None
        self._gain = self._speed_m_per_s = self._added_m_per_s = self._rendered_n = 0.0
        # Copies: attributes of a scene take longer to read.
        self._tick_ns = scene.tick_ns
        self.count = self.loop.horizon + 1
        self._target = delay_line(self.loop.lead_ns / scene.tick_ns)
        self._group_delay_ns = 0
        self._concealment = Concealment(Linear(0), scene.tick_ns)
        self._prediction = PredictionScore(scene.tick_ns)
        self._beats = BeatStatistics()
        # Samples that the scores and the beats have not seen, with the pulse's height; and the
        # prediction of this tick: its instant, force, offset, height, and whether it is felt.
        self._unscored: deque[tuple[ChannelSamples, float | None]] = deque()
        self._predicted: tuple[int, float, float, float | None, bool] | None = None
        self._reference_n: list[float] = []
        self._reading_n = 0.0

    def use(self, hardware: Hardware) -> None:
        """Play on a started real bench instead of the models. Call before the first tick."""
        self._hardware, self.feedback = hardware, hardware.feedback
        if self.tracking_error is not None:
            self.tracking_error.film_age_ns = self.film_age_ns
        stepper, drive = self.scene.actuator.stepper, self.scene.drive
        if self.press is not None and drive is not None and stepper is not None:
            law = stepper.contact(self.layer)
            self._tip = YieldingTip(law, drive.touch_m, self._tick_ns * 1e-9)

    def begin(self, description: StreamDescription, predictor: Predictor) -> None:
        """Begin a session, whose samples, times and clock are unrelated to those before.

        predictor: of the channel; it has seen nothing.
        """
        self.force_ratio = matching_force_ratio(description.layer, self.layer)
        self._group_delay_ns = description.group_delay_ns
        self.lead_ns = description.group_delay_ns + self.loop.lead_ns
        self.reach_ns = self.lead_ns + self.loop.horizon * self._tick_ns
        self.reserve_ns = self.reach_ns + description.period_ns
        self._concealment = Concealment(predictor, self._tick_ns)
        self._unscored.clear()
        self._prediction.restart()
        self._beats.restart()

    def observe(self, samples: ChannelSamples, cell: ChannelSamples | None = None) -> None:
        """Take new samples of the channel; cell: of the load cell, where the finger presses."""
        self._concealment.observe(samples)
        if self.press is not None and cell is not None:
            pressed = self.press.observe(samples, cell)
            self.press.take_beats(self._beats.observe(pressed))
        self._unscored.append((samples, self._concealment.height_n))
        if len(self._unscored) > MOST_UNSCORED:
            self._score_samples()

    def finish_scores(self) -> None:
        """Score all that waits; no further tick follows."""
        while self._score_samples():
            pass
        if self.tracking_error is not None:
            self.tracking_error.finish()

    def _score_samples(self) -> bool:
        """Find the beats of the oldest frame, and score by it; return whether there was any."""
        if not self._unscored:
            return False
        samples, height_n = self._unscored.popleft()
        if self.press is None:
            self._beats.observe(samples)
        self._prediction.add_reference(samples, self.force_ratio, height_n)
        if self.tracking_error is not None:
            self.tracking_error.add_reference(samples, self.force_ratio, self._group_delay_ns)
        return True

    @property
    def error_shares(self) -> list[float]:
        """Expected squared errors of the prediction, as `Concealment` returns them."""
        return self._concealment.error_shares

    def work(self) -> bool:
        """Do one piece of the work that no command waits for; return whether there was any."""
        error = self.tracking_error
        return (
            self._concealment.work()
            or self._score_samples()
            or (error is not None and error.work())
        )

    def follow(self, now_ns: int, elapsed_ticks: int, safety: Safety) -> None:
        """Follow the drive of a real bench since the last tick, and latch its fault."""
        hardware, loop = self._hardware, self.loop
        if hardware is None:
            return
        fault = hardware.read() or hardware.overrun(elapsed_ticks)
        if fault is not None and not safety.faults:
            safety.fault(self._prefix + fault)
        loop.shift(hardware.deviation_m(now_ns, self._speed_m_per_s, elapsed_ticks))

    def rest(self, now_ns: int) -> None:
        """Request no force in this tick, since no stream is played."""
        self._reference_n = [0.0] * self.count
        state = self.state
        state.now_ns, state.predictor_error_n, state.trusted = now_ns, math.nan, False

    def play(
        self, wrist_n: list[float], sampled_ns: int, newest_ns: int, full: bool | None
    ) -> int | None:
        """Compute the reference of this tick.

        Parameters
        ----------
        wrist_n
            Received force at the wrist in N, one a tick: at most `count` values.
        sampled_ns
            Time of the first of them: of the sample that shows the played instant.
        newest_ns
            Time of the newest sample.
        full
            Whether the pulse is felt at full strength; None where the stream is stale.

        Returns
        -------
        int or None
            The time in ns over which the force was predicted, 0 for a received one; None before
            the first sample, where no force is requested.
        """
        concealment, count, ratio = self._concealment, self.count, self.force_ratio
        predicted_ns, expected_n = 0, math.nan
        if not wrist_n:
            if sampled_ns < newest_ns:
                self._reference_n, self.state.predictor_error_n = [0.0] * count, math.nan
                return None
            predicted_ns = sampled_ns - newest_ns
            error_n = concealment.error_n(predicted_ns)
            if error_n is not None:
                expected_n = ratio * error_n
        self.state.predictor_error_n = expected_n
        if concealment.acts or len(wrist_n) < count:
            wrist_n = concealment.complete(wrist_n, count, sampled_ns, newest_ns)
            if full is not None and concealment.acts:
                self._predicted = (
                    sampled_ns,
                    wrist_n[0],
                    concealment.offset_n,
                    concealment.height_n,
                    full,
                )
        if self.press is None:
            self._reference_n = [ratio * force_n for force_n in wrist_n]
        else:
            self._reference_n = self.press.scale(wrist_n, sampled_ns, self._tick_ns, ratio)
        return predicted_ns

    def read(self, now_ns: int, elapsed_ticks: int, safety: Safety) -> None:
        """Read the film under the finger, and latch a fault of it."""
        loop, feedback, state = self.loop, self.feedback, self.state
        if elapsed_ticks > 1:
            loop.coast(elapsed_ticks - 1)
        if feedback is None:
            state.felt_n, self._reading_n = loop.felt_n, loop.read_film()
            fault = self.bounds.reading_fault(self._reading_n)
        else:
            state.felt_n = self._reading_n = feedback.read(now_ns)
            if self._tip is not None and self.press is not None:
                self._read_around_press(self._tip, self.press)
            fault = feedback.silent_fault(now_ns) or self.bounds.reading_fault(state.felt_n)
            if fault is None and not safety.faults:
                fault = feedback.late_fault
        if fault is not None:
            safety.fault(self._prefix + fault)

    def tick(self, gain: float, alive: bool, faults: list[str]) -> str | None:
        """Advance the force loop by one tick; return the fault of the withdrawal, or None.

        On a real bench, the drive receives the controller's output, or after a fault the command to
        withdraw.
        """
        hardware, reference_n = self._hardware, self.bounds.bound(self._reference_n, gain)
        output = self.loop.tick(reference_n, self._reading_n)
        self._gain, target_n = gain, reference_n[0]
        fault = None
        if hardware is not None:
            if self._tip is not None and self.press is not None:
                self._yield(self._tip, self.press, hardware, target_n)
            self._speed_m_per_s = output + self._added_m_per_s
            fault = hardware.command(self._speed_m_per_s, faults)
        state = self.state
        state.target_n = target_n if self._target is None else self._target.step(target_n)
        state.scored = alive and gain == 1.0
        return None if fault is None else self._prefix + fault

    def note_prediction(self) -> None:
        """Keep the prediction of this tick for its score, after all contactors are commanded."""
        if self._predicted is not None:
            self._prediction.add_output(*self._predicted)
            self._predicted = None

    def rendered_n(self, press: LocalPress) -> float:
        """Return the pulse under the finger that presses."""
        if self._tip is None:
            return self.state.felt_n - press.target_static_n
        return self._rendered_n

    def _read_around_press(self, tip: YieldingTip, press: LocalPress) -> None:
        """Complete the film's reading by the press, and give the loop the pulse around it."""
        static_n, state = press.static_n, self.state
        state.felt_n = self._reading_n + press.unseen_n
        wanted_n, rendered_n = self._gain * static_n, self._rendered_n
        self._reading_n = tip.reading_n(state.felt_n, static_n, wanted_n, rendered_n, press.still)

    def _yield(
        self, tip: YieldingTip, press: LocalPress, hardware: Hardware, target_n: float
    ) -> None:
        """Let the tip yield to the finger by the model of the tissue."""
        static_n = press.static_n
        wanted_n = self._gain * static_n
        self._rendered_n = target_n - wanted_n
        tip.follow(static_n, wanted_n, target_n, press.yielded_m, hardware.position_m)
        hardware.place_finger(tip.origin_m, press.unseen_n)
        self._added_m_per_s = tip.speed_m_per_s

    @property
    def film_age_ns(self) -> int:
        """Age of a reading of the real film; 0 where the film is modelled."""
        return 0 if self.feedback is None else self.scene.film.latency_ns

    def playback(self, channel: int) -> PlaybackStatus:
        """Return which channel is played, and how."""
        scene = self.scene
        return PlaybackStatus(
            self.name,
            channel,
            self.force_ratio,
            self.layer.strain_per_newton,
            scene.predictor.kind,
            scene.safety.stale_after_ns,
            self.film_age_ns,
        )

    def summary(
        self, samples: SampleCounts, loop: Loop, played_s: float, felt_n: float, now_ns: int
    ) -> Summary:
        """Return this contactor's figures.

        samples: account of the channel. loop: numbers of the display's ticks. played_s: time for
        which a pulse was played. felt_n: force under the finger after the last of these ticks, by
        the model. now_ns: time at which a real bench measures it.
        """
        hardware, error = self._hardware, self.tracking_error
        finger = FingerState(felt_n, measured_by="model, no drive")
        known = hardware is None or hardware.measures_force
        figures = Summary(
            samples=samples,
            compensation=self._prediction.add_to(Compensation(), played_s),
            beats=self._beats.figures(),
            limited=self._limits(loop.ticks or 0),
            hardware={} if hardware is None else dict(hardware.counts),
            finger=describe_finger(finger if hardware is None else hardware.finger(now_ns)),
            finger_stiffness=self.loop.finger_stiffness if known else None,
        )
        return figures if error is None else error.add_to(figures, loop)

    @property
    def notes(self) -> list[str]:
        """Errors of the real film's sensor, which are no faults."""
        notes = [] if self._hardware is None else self._hardware.faults()
        return [f"{FILM_NOTE}{self._prefix}{note}" for note in notes]

    def _limits(self, ticks: int) -> Limits:
        """Return how often and how long each limit has held, in ticks that were run.

        On a real bench the modelled film's range does not apply, and the drive counts the travel.
        """
        bounds, loop, tick_s = self.bounds, self.loop, self._tick_ns * 1e-9
        counters: dict[str, LimitCounter | None] = {
            "force": bounds.at_force_limit,
            "negative": bounds.below_zero,
            "slew": bounds.at_slew_limit,
        }
        if self._hardware is None:
            counters |= {"film": loop.at_film_range, "travel": loop.at_end}
        else:
            counters["travel"] = self._hardware.at_end
        held = {name: counter for name, counter in counters.items() if counter is not None}
        return Limits(**{name: counter.limited(tick_s, ticks) for name, counter in held.items()})
