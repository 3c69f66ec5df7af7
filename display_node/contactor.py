"""One contactor of a display: a channel of the stream, played on one actuator. Pure.

The display decides which instant is played, for all contactors; each contactor predicts what has
not arrived of its channel, scales it to its finger and runs its own force loop.
"""

import math
from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING

from display_node.control.force_bounds import ForceBounds
from display_node.control.link_loss import Fade
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
from protocol.faults import Fault, Note, Part
from protocol.finger import FingerState
from protocol.summary.fields import Compensation, Limits, Loop, SampleCounts, Summary
from protocol.tactile import matching_force_ratio
from protocol.ticks import NOT_PLAYED, TickState
from protocol.wire.description import StreamDescription
from protocol.wire.messages import ChannelSamples
from protocol.wire.telemetry import PlaybackStatus

# Frames that wait for the slack to be scored; beyond, the oldest is scored at once.
MOST_UNSCORED = 64

if TYPE_CHECKING:
    from display_node.prediction.path_errors import ExpectedErrors


class Contactor:
    """A contactor and the state of its channel.

    Parameters
    ----------
    scene
        The display's settings with those of this contactor.
    score
        Whether to compute the running errors of the felt force against the received one.
    among_several
        The display has further contactors, so that faults name this one.

    Attributes
    ----------
    feedback
        Readings of a real film, which replace those of the scene's models.
    reference_ticks
        Number of ticks that the reference covers: the present one and the loop's horizon.
    force_ratio
        Force at the finger per force at the wrist that makes both strains equal.
    sample_lead_ns
        Time by which the sample that is played is later than the played instant of the pulse: the
        group delay of the sensing chain, and the delay of the loop's actuation.
    reserve_ns
        The delay that "auto" adds for the loop: to the sample after the end of its horizon.
    press
        The finger's press, which scales the pulse; None where it is not sent to the wrist.
    state
        State of the last tick.
    """

    def __init__(self, scene: DisplayScene, score: bool, among_several: bool = False) -> None:
        self.scene, self.name = scene, scene.shown_name
        self._fault_name = self.name if among_several else ""
        self.feedback: Feedback | None = None
        self.layer = scene.layer.layer()
        self.state = TickState()
        self.force_ratio = 1.0
        self.sample_lead_ns = self.reserve_ns = 0
        self.bounds = ForceBounds(scene.safety, scene.tick_ns)
        self.loop = scene.force_loop()
        self.tracking_error = TrackingError(self.layer.strain_per_newton) if score else None
        self.press: LocalPress | None = None
        self._hardware: Hardware | None = None
        self._tip: YieldingTip | None = None
        self._gain = self._target_n = 0.0
        # Copies: attributes of a scene take longer to read.
        self._tick_ns = scene.tick_ns
        self.reference_ticks = self.loop.horizon + 1
        self._target_delay = delay_line(self.loop.actuation_delay_ns / scene.tick_ns)
        self._group_delay_ns = 0
        self._concealment = Concealment(Linear(0), scene.tick_ns)
        self._prediction_score = PredictionScore(scene.tick_ns)
        self._beats = BeatStatistics()
        # Samples that the scores and the beats have not seen, with the pulse's height; and the
        # prediction of this tick: its instant, force, offset, height, and whether it is felt.
        self._unscored: deque[tuple[ChannelSamples, float | None]] = deque()
        self._predicted: tuple[int, float, float, float | None, bool] | None = None
        # As in `TickState`, of this contactor.
        self._predicted_ns = NOT_PLAYED
        # Reference now and in the next ticks, before its bounds, and the loop's film reading.
        self._reference_n: list[float] = []
        self._reading_n = 0.0

    def use(self, hardware: Hardware) -> None:
        """Play on a started real bench instead of the models. Call before the first tick."""
        self._hardware, self.feedback = hardware, hardware.feedback
        self.loop.leave_to_bench()
        stepper, drive = self.scene.actuator.stepper, self.scene.drive
        if self.press is not None and drive is not None and stepper is not None:
            law = stepper.contact(self.layer)
            self._tip = YieldingTip(self.press, law, drive.touch_m, self._tick_ns * 1e-9)

    def begin(self, description: StreamDescription, predictor: Predictor) -> None:
        """Begin a session, whose samples, times and clock are unrelated to those before.

        predictor: of the channel; it has seen nothing.
        """
        self.force_ratio = matching_force_ratio(description.layer, self.layer)
        self._group_delay_ns = description.group_delay_ns
        self.sample_lead_ns = description.group_delay_ns + self.loop.actuation_delay_ns
        horizon_ns = self.loop.horizon * self._tick_ns
        self.reserve_ns = self.sample_lead_ns + horizon_ns + description.period_ns
        self._concealment = Concealment(predictor, self._tick_ns)
        self._unscored.clear()
        self._prediction_score.restart()
        self._beats.restart()
        if self.tracking_error is not None:
            self.tracking_error.begin_session(self.film_age_ns)

    def observe(self, samples: ChannelSamples, cell: ChannelSamples | None = None) -> None:
        """Take new samples of the channel for predictor, beats and scores.

        Those that are played come by `play`, from the buffer. cell: samples of the load cell, where
        the finger presses.
        """
        self._concealment.observe(samples)
        if self.press is not None and cell is not None:
            pressed = self.press.observe(samples, cell)
            self.press.take_beats(self._beats.observe(pressed))
        self._unscored.append((samples, self._concealment.height_n))
        if len(self._unscored) > MOST_UNSCORED:
            self._score_samples()

    def read_hardware(self, now_ns: int, elapsed_ticks: int, fade: Fade) -> None:
        """Take the drive's motion and the film's samples since the last tick, and a fault."""
        hardware, loop = self._hardware, self.loop
        if hardware is None:
            return
        fault = hardware.read(now_ns) or hardware.overrun(elapsed_ticks, now_ns)
        if fault is not None and not fade.faults:
            self.latch(fault, fade)
        held_ticks = elapsed_ticks if elapsed_ticks < loop.held_ticks else loop.held_ticks
        loop.shift(hardware.deviation_m(now_ns, held_ticks))

    def rest(self, now_ns: int) -> None:
        """Request no force in this tick, since no stream is played."""
        self._reference_n = [0.0] * self.reference_ticks
        self._predicted_ns = NOT_PLAYED
        self.state.now_ns, self.state.trusted = now_ns, False

    def play(
        self, wrist_n: list[float], sampled_ns: int, newest_ns: int, alive: bool, full: bool
    ) -> int:
        """Compute the reference of this tick.

        Parameters
        ----------
        wrist_n
            Received force at the wrist in N, one a tick: at most `reference_ticks` values.
        sampled_ns
            Time of the first of them: of the sample that shows the played instant.
        newest_ns
            Time of the newest sample.
        alive
            Whether the stream is not stale, and no fault is latched.
        full
            Whether the pulse was felt at full strength in the last tick.

        Returns
        -------
        int
            The time in ns over which the force was predicted, 0 for a received one; `NOT_PLAYED`
            before the first sample, where no force is requested.
        """
        concealment, count, ratio = self._concealment, self.reference_ticks, self.force_ratio
        predicted_ns = 0
        if not wrist_n:
            if sampled_ns < newest_ns:
                self._reference_n = [0.0] * count
                self._predicted_ns = NOT_PLAYED
                return NOT_PLAYED
            predicted_ns = sampled_ns - newest_ns
        self._predicted_ns = predicted_ns
        if concealment.acts or len(wrist_n) < count:
            wrist_n = concealment.complete(wrist_n, count, sampled_ns, newest_ns)
            if alive and concealment.acts:
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

    def read_force(self, now_ns: int, fade: Fade) -> None:
        """Determine the felt force and the film's reading of this tick, and latch a fault of it."""
        loop, feedback, state = self.loop, self.feedback, self.state
        if feedback is None:
            state.felt_n, self._reading_n = loop.felt_n, loop.read_film()
            fault = self.bounds.reading_fault(self._reading_n, now_ns)
        else:
            state.felt_n = self._reading_n = feedback.read(now_ns)
            if self._tip is not None:
                state.felt_n = self._tip.felt_n(self._reading_n)
                self._reading_n = self._tip.reading_n(state.felt_n)
            fault = self._feedback_fault(feedback, now_ns, fade)
        if fault is not None:
            self.latch(fault, fade)

    def _feedback_fault(self, feedback: Feedback, now_ns: int, fade: Fade) -> Fault | None:
        """Return the fault of a reading of the film, or of its absence."""
        hardware = self._hardware
        if not feedback.alive(now_ns) and hardware is not None and not hardware.measures_force:
            # The drive's positions stand in for a film. What keeps them away is the drive's fault,
            # which its supervisor names.
            return None
        fault = feedback.silent_fault(now_ns) or self.bounds.reading_fault(
            self.state.felt_n, now_ns
        )
        return fault or (None if fade.faults else feedback.late_fault(now_ns))

    def latch(self, fault: Fault, fade: Fade) -> None:
        """Latch a fault of this contactor."""
        fade.fault(replace(fault, contactor=self._fault_name))

    def rendered_n(self, press: LocalPress) -> float:
        """Return the pulse under the finger that presses."""
        if self._tip is None:
            return self.state.felt_n - press.target_static_n
        return self._tip.rendered_n

    def command(self, gain: float, fade: Fade) -> None:
        """Compute a tick's output and command it, and latch the fault of a withdrawal.

        On a real bench, the drive receives the controller's output, or after a fault the command to
        withdraw.
        """
        hardware, bounded_n = self._hardware, self.bounds.bound(self._reference_n, gain)
        output = self.loop.output(bounded_n, self._reading_n)
        self._gain, self._target_n = gain, bounded_n[0]
        if hardware is None:
            return
        if self._tip is not None:
            output += self._tip.follow(self._target_n, gain, hardware)
        fault = hardware.command(output, fade.faults, self._fault_name)
        if fault is not None:
            self.latch(fault, fade)

    def account(self, alive: bool) -> None:
        """Note the commanded tick."""
        state, target_n = self.state, self._target_n
        state.target_n = (
            target_n if self._target_delay is None else self._target_delay.step(target_n)
        )
        state.full = alive and self._gain == 1.0
        predicted_ns = self._predicted_ns
        error_n = self._concealment.error_n(predicted_ns) if predicted_ns > 0 else None
        state.predictor_error_n = math.nan if error_n is None else self.force_ratio * error_n
        if self._predicted is not None:
            self._prediction_score.add_output(*self._predicted)
            self._predicted = None

    def work(self) -> bool:
        """Do one piece of the work that no command waits for; return whether there was any."""
        error = self.tracking_error
        return (
            self._concealment.work()
            or self._score_samples()
            or (error is not None and error.work())
        )

    def _score_samples(self) -> bool:
        """Find the beats of the oldest frame, and score by it; return whether there was any."""
        if not self._unscored:
            return False
        samples, height_n = self._unscored.popleft()
        if self.press is None:
            self._beats.observe(samples)
        self._prediction_score.add_samples(samples, self.force_ratio, height_n)
        if self.tracking_error is not None:
            self.tracking_error.add_samples(samples, self.force_ratio, self._group_delay_ns)
        return True

    def finish_scores(self) -> None:
        """Score all that waits; no further tick follows."""
        while self._score_samples():
            pass
        if self.tracking_error is not None:
            self.tracking_error.finish()

    @property
    def expected(self) -> "ExpectedErrors | None":
        """Errors to expect of the channel's prediction, as of `Predictor`."""
        return self._concealment.expected

    @property
    def noticed_5s(self) -> float:
        """Share of the last 5 s in which an error of the prediction was felt."""
        return self._prediction_score.noticed_5s

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
        the model; a real bench, where it is the film's reading, measures the finger anew at now_ns.
        """
        hardware, error = self._hardware, self.tracking_error
        finger = FingerState(felt_n, measured_by="model, no drive")
        known = hardware is None or hardware.measures_force
        figures = Summary(
            samples=samples,
            compensation=self._prediction_score.add_to(Compensation(), played_s),
            beats=self._beats.figures(self.force_ratio if self.press is None else None),
            limited=self._limits(loop.ticks or 0),
            hardware={} if hardware is None else dict(hardware.counts),
            finger=finger if hardware is None else hardware.finger(now_ns),
            finger_stiffness=self.loop.finger_stiffness if known else None,
        )
        return figures if error is None else error.add_to(figures, loop)

    @property
    def notes(self) -> list[Note]:
        """Errors of the real film's sensor, which are no faults."""
        notes = [] if self._hardware is None else self._hardware.faults()
        return [Note(Part.FILM, note, self._fault_name) for note in notes]

    def _limits(self, ticks: int) -> Limits:
        """Return how often and how long each limit has held, in ticks that were run.

        On a real bench the modelled film's range does not apply, and the drive counts the travel.
        """
        hardware, tick_s = self._hardware, self._tick_ns * 1e-9
        own = self.loop.counters if hardware is None else {"travel": hardware.at_end}
        counters = self.bounds.counters | own
        return Limits(**{name: each.limited(tick_s, ticks) for name, each in counters.items()})
