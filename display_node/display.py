"""The display without I/O: received bytes and ticks in, force at the finger out.

The live node and the virtual-time simulation drive this same class; time is an argument.
"""

import math
from dataclasses import replace
from typing import Final

from display_node.control.safety import Safety
from display_node.drives.hardware import Hardware
from display_node.drives.withdrawal import FingerState, describe_finger
from display_node.plant.feedback import Feedback
from display_node.plant.filters import delay_line
from display_node.prediction.concealment import Concealment
from display_node.reception.playout import PlayedDelays, PlayoutClock
from display_node.reception.receiver import Receiver
from display_node.scene import DisplayScene
from display_node.scoring.beat_statistics import BeatStatistics
from display_node.scoring.prediction_score import PredictionScore
from display_node.scoring.tracking_error import TrackingError
from protocol.counters import Limits
from protocol.run_summary import Summary
from protocol.summary_tables import Compensation, Loop, TickTime
from protocol.tactile import matching_force_ratio
from protocol.ticks import AvailabilityCounter, InterruptionCounter, LimitCounter, TickState
from protocol.wire.messages import ControlMessage, DisplayReport
from protocol.wire.telemetry import PlaybackStatus, pack_status

REPORT_EVERY_NS: Final = 1_000_000_000


class Display:
    """One display: receives a stream and plays it on its actuator.

    score: whether to compute the running errors of the felt force against the received one.
    feedback: readings of a real film, which replace those of the scene's models. force_ratio: force
    at the finger per force at the wrist that makes both strains equal. tick_state: state of the
    last tick. ticks: number of ticks that were run.
    """

    def __init__(self, scene: DisplayScene, name: str, score: bool = True) -> None:
        self._scene, self._name = scene, name
        self._hardware: Hardware | None = None
        self.feedback: Feedback | None = None
        self._layer = scene.layer.layer()
        # Copies: attributes of a scene take longer to read.
        self._tick_ns = scene.tick_ns
        self._compensation_ns, self._stale_after_ns = (
            scene.compensation_ns,
            scene.safety.stale_after_ns,
        )
        self._concealment = self._build_concealment()
        self._loop = scene.force_loop()
        self._target = delay_line(self._loop.lead_ns / scene.tick_ns)
        self._playout = PlayoutClock()
        self._resets = 0
        self.force_ratio = 1.0
        self._group_delay_ns = self._lead_ns = self._reach_ns = self._reserve_ns = 0
        self._next_report_ns = 0
        self._delays = PlayedDelays()
        self._prediction = PredictionScore(scene.tick_ns)
        self._beats = BeatStatistics()
        self._availability = AvailabilityCounter(scene.tick_ns * 1e-9)
        self._interruptions = InterruptionCounter(scene.tick_ns * 1e-9)
        self.tracking_error = TrackingError(self._layer.strain_per_newton) if score else None
        self.receiver = Receiver(name, scene.channel, scene.late_target, scene.paths or 1)
        self.safety = Safety(scene.safety, scene.tick_ns)
        self.tick_state = TickState()
        self.ticks = 0

    def use(self, hardware: Hardware) -> None:
        """Play on a started real bench instead of the models. Call before the first tick."""
        self._hardware, self.feedback = hardware, hardware.feedback

    @property
    def state(self) -> str:
        """The display's state: waiting, starting, playing, stale, ended or fault."""
        if self.safety.faults:
            return "fault"
        if not self.receiver.ready:
            return "waiting"
        if self.tick_state.scored:
            return "playing"
        if self.receiver.buffer.ended:
            return "ended"
        return "starting" if self.safety.gain else "stale"

    def pack_status(self, summary: Summary, final: bool) -> bytes:
        """Encode this display's status with a summary."""
        description, session = self.receiver.description, self.receiver.session
        if description is None:
            return pack_status(self.state, "", summary, final, session)
        playing = PlaybackStatus(
            self._scene.channel,
            self.force_ratio,
            self._layer.strain_per_newton,
            self._scene.predictor,
            self._scene.safety.stale_after_ns,
        )
        return pack_status(self.state, description.name, summary, final, session, playing=playing)

    @property
    def over(self) -> bool:
        """True when the session has ended and all of it was played."""
        receiver, state = self.receiver, self.tick_state
        return receiver.buffer.ended and receiver.over(state.now_ns, state.playout_delay_ns)

    def on_frame(self, data: bytes, now_ns: int) -> None:
        """Take a data message."""
        samples = self.receiver.on_frame(data, now_ns)
        if samples is None:
            return
        concealment = self._concealment
        concealment.observe(samples)
        self._beats.observe(samples)
        self._prediction.add_reference(samples, self.force_ratio, concealment.height_n)
        if self.tracking_error is not None:
            self.tracking_error.add_reference(samples, self.force_ratio, self._group_delay_ns)

    def on_control(self, data: bytes, now_ns: int) -> None:
        """Take a control message."""
        self.receiver.on_control(data, now_ns)
        resets, description = self.receiver.resets, self.receiver.description
        if resets != self._resets and description is not None:
            self._resets = resets
            self.force_ratio = matching_force_ratio(description.layer, self._layer)
            self._group_delay_ns = description.group_delay_ns
            self._lead_ns = description.group_delay_ns + self._loop.lead_ns
            self._playout = PlayoutClock()
            self._concealment = self._build_concealment()
            self._prediction.restart()
            self._beats.restart()
            self._reach_ns = self._lead_ns + self._loop.horizon * self._tick_ns
            # "auto" adds this delay for the loop: up to the sample after the end of its horizon.
            self._reserve_ns = self._reach_ns + description.period_ns

    def requests(self, now_ns: int) -> list[ControlMessage]:
        """Return the requests and reports to send to the sensing node now."""
        wanted = self.receiver.requests(now_ns)
        if now_ns >= self._next_report_ns and self.receiver.session is not None:
            self._next_report_ns = now_ns + REPORT_EVERY_NS
            wanted.append(self._report(self.receiver.session))
        return wanted

    def tick(self, now_ns: int, elapsed_ticks: int = 1) -> TickState:
        """Advance the force loop to `now_ns`, `elapsed_ticks` ticks after the last one.

        On a real bench, the drive receives the controller's output, or after a fault the command to
        withdraw.
        """
        hardware, safety, state, loop = self._hardware, self.safety, self.tick_state, self._loop
        if hardware is not None:
            fault = hardware.read() or hardware.overrun(elapsed_ticks)
            if fault is not None and not safety.faults:
                safety.fault(fault)
            loop.shift(hardware.deviation_m(now_ns, loop.output, elapsed_ticks))
        reference_n, alive = self._reference(now_ns)
        if elapsed_ticks > 1:
            loop.coast(elapsed_ticks - 1)
            safety.skip(elapsed_ticks)
        if self.feedback is None:
            felt_n, reading_n = loop.felt_n, loop.read_film()
            safety.watch(reading_n)
        else:
            felt_n = reading_n = self.feedback.read(now_ns)
            if (silent := self.feedback.silent_fault(now_ns)) is not None:
                safety.fault(silent)
            else:
                safety.watch(reading_n)
                if (late := self.feedback.late_fault) is not None and not safety.faults:
                    safety.fault(late)
        reference_n = safety.bound(reference_n, alive)
        loop.tick(reference_n, reading_n)
        self.ticks += 1
        target_n = reference_n[0]
        state.target_n = target_n if self._target is None else self._target.step(target_n)
        state.felt_n = felt_n
        state.scored = alive and safety.gain == 1.0
        self._availability.add(self.state, elapsed_ticks)
        self._interruptions.add(state.scored, elapsed_ticks)
        if state.scored and self.tracking_error is not None:
            # Age of a reading of a real film.
            age_ns = self._scene.film.latency_ns if self.feedback is not None else 0
            self.tracking_error.add_output(
                state.sensing_now_ns - age_ns, state.instant_ns - age_ns, felt_n
            )
        if hardware is not None:
            fault = hardware.command(loop.output, safety.faults)
            if fault is not None:
                safety.fault(fault)
        return state

    def _build_concealment(self) -> Concealment:
        scene = self._scene
        auto = scene.compensation_ns is None
        return Concealment(scene.predictor, scene.tick_ns, auto)

    def _reference(self, now_ns: int) -> tuple[list[float], bool]:
        """Return the target force until the loop's horizon, and whether the stream is alive."""
        receiver, state, count = self.receiver, self.tick_state, self._loop.horizon + 1
        buffer, concealment, delay_ns = receiver.buffer, self._concealment, receiver.delay.delay_ns
        newest_ns = buffer.newest_ns
        state.now_ns, state.predictor_error_n, state.trusted = now_ns, math.nan, False
        if not receiver.ready or delay_ns is None or newest_ns is None:
            return [0.0] * count, False
        sensing_now_ns = receiver.clock.remote_ns(now_ns)
        wanted_delay_ns = self._compensation_ns
        if wanted_delay_ns is None:
            age_ns = sensing_now_ns + self._reach_ns - newest_ns
            required_ns = delay_ns + self._reserve_ns
            wanted_delay_ns = concealment.delay_ns(now_ns, required_ns, age_ns)
            state.trusted = bool(concealment.trusted)
        instant_ns = self._playout.instant(now_ns, sensing_now_ns - wanted_delay_ns)
        state.sensing_now_ns, state.instant_ns = sensing_now_ns, instant_ns
        # The sensing chain delays the pulse by its group delay: the pulse of `instant_ns` is in the
        # sample taken that much later. The actuator's lag is compensated in the same way.
        sampled_ns = instant_ns + self._lead_ns
        alive = receiver.live(sampled_ns, sensing_now_ns, self._stale_after_ns)
        buffer.advance(sampled_ns, alive and state.trusted)
        wrist_n = buffer.known(self._tick_ns, count)
        concealment.work()
        if not wrist_n and sampled_ns < newest_ns:
            return [0.0] * count, False
        ratio = self.force_ratio
        predicted_ns = 0 if wrist_n else sampled_ns - newest_ns
        if not wrist_n:
            error_n = concealment.error_n(predicted_ns)
            state.predictor_error_n = math.nan if error_n is None else ratio * error_n
        wrist_n = concealment.complete(wrist_n, count, sampled_ns, newest_ns)
        if alive:
            self._delays.add(sensing_now_ns - instant_ns, predicted_ns, state.trusted)
            if concealment.acts:
                self._add_prediction(sampled_ns, wrist_n[0])
        return [ratio * force_n for force_n in wrist_n], alive

    def _add_prediction(self, sampled_ns: int, wrist_n: float) -> None:
        concealment, full = self._concealment, self.safety.gain == 1.0
        self._prediction.add_output(
            sampled_ns, wrist_n, concealment.offset_n, concealment.height_n, full
        )

    def _report(self, session: int) -> DisplayReport:
        counts, delay_ms = self.receiver.account(), self.receiver.one_way_delay_ms
        errors = self.tracking_error
        figures = (
            delay_ms.quantile(0.5),
            delay_ms.quantile(0.99),
            self._delays.playout_delay_ms.mean,
            None if errors is None else errors.force_rmse_n.aligned,
        )
        numbers = (math.nan if figure is None else figure for figure in figures)
        parts = counts.played, counts.predicted, counts.late, counts.lost
        return DisplayReport(session, self._name, *parts, *numbers)

    def summary(
        self, deadline_misses: int | None = None, tick_us: TickTime | None = None
    ) -> Summary:
        """Return the summary so far; the arguments are the figures of the caller's loop."""
        finger = FingerState(self.tick_state.felt_n, measured_by="model, no drive")
        summary = replace(
            self.receiver.summary(self.tick_state.now_ns),
            playout_delay_ms=self._delays.playout_delay_ms,
            covered_delay_ms=self._delays.covered_delay_ms,
            availability=self._availability.availability(self._delays.ticks),
            interruptions=self._interruptions.interruptions(),
            compensation=self._compensation(),
            beats=self._beats.figures(),
            limited=self._limits(),
            loop=Loop(self.ticks, deadline_misses, tick_us or TickTime()),
            rejected=dict(self.receiver.rejected),
            faults=list(self.safety.faults),
            # On a real bench, `DisplayNode` adds the measured state.
            finger=describe_finger(finger) if self.feedback is None else None,
            finger_stiffness=self._loop.finger_stiffness,
        )
        return self.tracking_error.scored(summary) if self.tracking_error is not None else summary

    def _compensation(self) -> Compensation:
        delays = self._delays
        compensation = delays.compensation(may_trust=self._concealment.trusted is not None)
        return self._prediction.scored(compensation, delays.ticks * self._tick_ns * 1e-9)

    def _limits(self) -> Limits:
        """Return how often and how long each limit has held, in ticks that were run.

        With a real film, limits of the modelled actuator and film do not apply.
        """
        safety, loop, tick_s = self.safety, self._loop, self._tick_ns * 1e-9
        counters: dict[str, LimitCounter | None] = {
            "force": safety.at_force_limit,
            "negative": safety.below_zero,
            "slew": safety.at_slew_limit,
        }
        if self.feedback is None:
            counters |= {"film": loop.at_film_range, "travel": loop.at_end}
        held = {name: counter for name, counter in counters.items() if counter is not None}
        return Limits(
            **{name: counter.limited(tick_s, self.ticks) for name, counter in held.items()}
        )
