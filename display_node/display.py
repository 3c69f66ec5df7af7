"""The display without I/O: received bytes and ticks in, forces at the fingers out.

The live node and the virtual-time simulation drive this same class; time is an argument.
"""

import math
from collections.abc import Callable, Generator
from dataclasses import replace
from typing import Final

from display_node.contactor import Contactor
from display_node.control.link_loss import Fade
from display_node.hardware import Hardware
from display_node.playout import Playout
from display_node.prediction.announcement import BeatAnnouncement
from display_node.press.local_press import LocalPress
from display_node.reception.receiver import Receiver
from display_node.scene import DisplayScene
from display_node.scoring.availability import AvailabilityCounter, InterruptionCounter
from display_node.scoring.played_delays import PlayedDelays
from protocol.pieces import complete
from protocol.summary.fields import (
    AnnounceFigures,
    Loop,
    PressFigures,
    SampleCounts,
    Summary,
    with_contactors,
)
from protocol.ticks import TickBlock, TickState
from protocol.wire.messages import ControlMessage, DisplayReport, SetPoint
from protocol.wire.telemetry import pack_status

REPORT_EVERY_NS: Final = 1_000_000_000
# The press in the state of the ticks is renewed after so many: a set-point is sent every 20 ms.
PRESS_TICKS: Final = 10
# Ticks are counted and scored in blocks of this time, but of not more ticks: a trace of two blocks
# has to fit into a message. This is done in the slack, or with the last tick of the second block.
BLOCK_NS, MOST_BLOCK_TICKS = 100_000_000, 250


class Display:
    """One display: receives a stream and plays it on its contactors.

    All contactors play the same instant of the pulse, by one playout clock and one perceived delay
    E, which is the largest that any of them requires. A fault of one brings all to rest.

    score: whether to compute the running errors of the felt force against the received one; there
    is none where the finger presses back. press: random number of the run, for its set-points.
    contactors: one or several. states: of the contactors at the last tick. ticks: number of ticks
    that were run. take_ticks: function that receives each block of ticks, whose arrays are valid
    until it returns: the node's writer of traces, or a simulation's comparison with the truth.
    """

    def __init__(self, scene: DisplayScene, name: str, score: bool = True, press: int = 0) -> None:
        self._scene, self._name = scene, name
        # Copies: attributes of a scene take longer to read.
        self._tick_ns = scene.tick_ns
        several = len(scene.contactors) > 1
        score = score and scene.press is None
        self.contactors = [
            Contactor(each, score, among_several=several) for each in scene.contactors
        ]
        # The first building loads the predictor's kernels for half a second, or compiles them for
        # several. In the loop, this would spoil the first exchanges of the clock.
        scene.predictor.build(scene.tick_ns, 1)
        self.states = [contactor.state for contactor in self.contactors]
        self._driven: list[Contactor] = []
        self._resets = 0
        self._announcement: BeatAnnouncement | None = None
        self._next_report_ns = 0
        self._delays = PlayedDelays()
        self._availability = AvailabilityCounter(scene.tick_ns * 1e-9)
        self._interruptions = InterruptionCounter(scene.tick_ns * 1e-9)
        selected = [each.channel for each in scene.contactors]
        self.press: LocalPress | None = None
        if scene.press is not None:
            # The load cell's channel comes after those that are played.
            selected.append(scene.press.channel)
            self.press = self.contactors[0].press = LocalPress(scene.press, press)
        self.receiver = Receiver(name, selected, scene.late_target, scene.paths)
        if self.press is not None:
            self.receiver.take_probe = self.press.take
        self._playout = Playout(scene, self.receiver, self.contactors)
        self.fade = Fade(scene.safety, scene.tick_ns)
        self.ticks = 0
        self._block_ticks = max(1, min(BLOCK_NS // scene.tick_ns, MOST_BLOCK_TICKS))
        self._block = TickBlock(len(self.contactors), 2 * self._block_ticks)
        self.take_ticks: Callable[[TickBlock], None] | None = None

    def use(self, *benches: Hardware | None) -> None:
        """Play on started real benches instead of the models. Call before the first tick.

        benches: in the contactors' order; None leaves a contactor its model.
        """
        for contactor, hardware in zip(self.contactors, benches, strict=True):
            if hardware is not None:
                contactor.use(hardware)
                self._driven.append(contactor)

    @property
    def state(self) -> str:
        """The display's state: waiting, starting, playing, stale, ended or fault."""
        if self.fade.faults:
            return "fault"
        if not self.receiver.ready:
            return "waiting"
        if self.states[0].full:
            return "playing"
        if self.receiver.buffer.ended:
            return "ended"
        return "starting" if self.fade.gain else "stale"

    def pack_status(self, summary: Summary, final: bool, state: str | None = None) -> bytes:
        """Encode this display's status with a summary; state: None for the present one."""
        receiver, state = self.receiver, state or self.state
        if receiver.description is None:
            return pack_status(state, "", summary, final, receiver.session)
        pairs = zip(self.contactors, receiver.channel_numbers, strict=self.press is None)
        playing = [contactor.playback(channel) for contactor, channel in pairs]
        name = receiver.description.name
        return pack_status(state, name, summary, final, receiver.session, playing=playing)

    @property
    def over(self) -> bool:
        """True when the session has ended and all of it was played."""
        receiver, state = self.receiver, self.states[0]
        return receiver.over(state.now_ns, state.playout_delay_ns)

    def on_frame(self, data: bytes, now_ns: int) -> None:
        """Take a data message."""
        received = self.receiver.on_frame(data, now_ns)
        if received is None:
            return
        # The load cell's channel is the last one of those that the receiver selects.
        cell = None if self.press is None else received.pop()
        for contactor, samples in zip(self.contactors, received, strict=True):
            contactor.observe(samples, cell)
        if self._announcement is not None and self.receiver.announcement is not None:
            self._announcement.observe(self.receiver.announcement)

    def on_control(self, data: bytes, now_ns: int) -> None:
        """Take a control message."""
        self.receiver.on_control(data, now_ns)
        resets, description = self.receiver.resets, self.receiver.description
        if resets != self._resets and description is not None:
            self._resets = resets
            # Its ticks are of the clock and the session before.
            self.close_block()
            predictors = self._scene.predictor.build(self._tick_ns, len(self.contactors))
            for contactor, predictor in zip(self.contactors, predictors, strict=True):
                contactor.begin(description, predictor)
            announced = self._scene.announce == "auto" and description.announcing is not None
            self._announcement = BeatAnnouncement(predictors[0]) if announced else None
            self._playout.begin()
            if self.press is not None:
                self.press.begin()

    def work(self) -> bool:
        """Do one piece of the work that no command waits for; return whether there was any.

        Such work is what the predictors learn and predict from new samples, beats, and the scores.
        Do it between two ticks; where there is no time for it, some pieces a tick nevertheless.
        """
        if self._block.count >= self._block_ticks:
            self.close_block()
            return True
        if self._playout.work():
            return True
        # Without `any` and its generator: this runs several times a tick.
        for contactor in self.contactors:  # noqa: SIM110
            if contactor.work():
                return True
        return False

    def finish_scores(self) -> None:
        """Score all that waits, at the end of the run."""
        self.close_block()
        for contactor in self.contactors:
            contactor.finish_scores()

    def requests(self, now_ns: int) -> list[ControlMessage]:
        """Return the requests and reports to send to the sensing node now."""
        wanted = self.receiver.requests(now_ns)
        if now_ns >= self._next_report_ns and self.receiver.session is not None:
            self._next_report_ns = now_ns + REPORT_EVERY_NS
            wanted.append(self._report(self.receiver.session))
        if self.press is not None and (set_point := self._set_point(now_ns)) is not None:
            wanted.append(set_point)
        return wanted

    def _set_point(self, now_ns: int) -> SetPoint | None:
        """Return the set-point of the finger's press that is due, if any."""
        receiver, press = self.receiver, self.press
        if press is None or not receiver.accepts_frames or receiver.session is None:
            return None
        if receiver.buffer.ended:
            return None
        clock, alive = receiver.clock, self.states[0].full and not self.fade.faults
        round_trip_ns = 2 * clock.asymmetry_bound_ns
        sensing_ns = clock.remote_ns(now_ns)
        return press.request(receiver.session, sensing_ns, round_trip_ns, now_ns, alive)

    def tick(self, now_ns: int, elapsed_ticks: int = 1) -> TickState:
        """Command a tick, move the models, and note it; return the first contactor's state."""
        self.command(now_ns, elapsed_ticks)
        self.move()
        return self.account(elapsed_ticks)

    def command(self, now_ns: int, elapsed_ticks: int = 1) -> None:
        """Command the outputs at `now_ns`, `elapsed_ticks` ticks after the last one.

        Drives receive them at once. `move` and `account` follow, for which no drive waits.
        """
        contactors, fade = self.contactors, self.fade
        for contactor in self._driven:
            contactor.read_hardware(now_ns, elapsed_ticks, fade)
        if elapsed_ticks > 1:
            for contactor in contactors:
                contactor.loop.coast(elapsed_ticks - 1)
        alive = self._playout.play(now_ns, fade.gain == 1.0, at_rest=bool(fade.faults))
        for contactor in contactors:
            contactor.read_force(now_ns, fade)
        if self.press is not None:
            self.press.tick(now_ns, contactors[0].rendered_n(self.press))
        if elapsed_ticks > 1:
            fade.skip(elapsed_ticks)
        gain = fade.advance(alive)
        for contactor in contactors:
            contactor.command(gain, fade)

    def move(self) -> None:
        """Move the modelled actuators under the commanded outputs; drives move by themselves."""
        for contactor in self.contactors:
            contactor.loop.move()

    def account(self, elapsed_ticks: int = 1) -> TickState:
        """Note the commanded tick; return the state of the first contactor."""
        for contactor in self.contactors:
            contactor.account(self.fade.alive)
        if self.press is not None and self.ticks % PRESS_TICKS == 0:
            self._show_press(self.press)
        state = self.states[0]
        state.display_state, state.elapsed_ticks = self.state, elapsed_ticks
        self._block.add(self.states)
        self.ticks += 1
        if self._block.count == self._block.most:
            self.close_block()
        return state

    def close_block(self) -> None:
        """Count, score and pass on the ticks since the last block.

        A block is closed by `work` once it is due, without slack by `account` at twice that; and
        early where figures must include the last tick: for a trace, a summary and the end.
        """
        block = self._block
        if not block.count:
            return
        ticks = block.columns
        self._delays.add(block)
        self._availability.add(ticks.display_state, ticks.elapsed_ticks)
        self._interruptions.add(ticks.full, ticks.elapsed_ticks)
        full = ticks.full != 0
        now_ns, instant_ns = ticks.now_ns[full], ticks.instant_ns[full]
        sensing_ns = ticks.sensing_now_ns[full]
        for place, contactor in enumerate(self.contactors):
            if (error := contactor.tracking_error) is not None:
                error.add_output(now_ns, sensing_ns, instant_ns, block.felt_n(place)[full])
        if self.take_ticks is not None:
            self.take_ticks(block)
        block.count = 0

    def _show_press(self, press: LocalPress) -> None:
        """Put the finger's press and the last reported hold-down into the state of the tick."""
        state, hold_down_n = self.states[0], press.hold_down_n
        state.press_n = press.press_n
        state.hold_down_n = math.nan if hold_down_n is None else hold_down_n

    def _report(self, session: int) -> DisplayReport:
        # The delay is of the last closed block, at most 0.2 s old; the error of ticks that are
        # judged already, which wait some 2 s for the pulse of their instants.
        counts, delay_ms = self.receiver.account(), self.receiver.one_way_delay_ms
        errors = (each.tracking_error for each in self.contactors)
        errors_n = (each.force_rmse_n.aligned for each in errors if each is not None)
        figures = (
            delay_ms.quantile(0.5),
            delay_ms.quantile(0.99),
            self._delays.playout_delay_ms.mean,
            max((error_n for error_n in errors_n if error_n is not None), default=None),
        )
        numbers = (math.nan if figure is None else figure for figure in figures)
        parts = counts.played, counts.predicted, counts.late, counts.lost
        return DisplayReport(session, self._name, *parts, *numbers)

    def summary(self, deadline_misses: int | None = None) -> Summary:
        """Return the summary so far; deadline_misses: of the caller's loop."""
        return complete(self.summary_pieces(deadline_misses))

    def summary_pieces(
        self, deadline_misses: int | None = None, now_ns: int | None = None
    ) -> Generator[None, None, Summary]:
        """Build the summary piece by piece.

        The first piece takes what must agree with the state of one tick: accounts, faults, and the
        felt forces. Beats and limits may be of later ticks. Errors are of the ticks judged so far:
        each waits for the pulse of its instant, some 2 s. now_ns: time at which the
        fingers on real benches are measured; None for that of the last tick.
        """
        self.close_block()
        delays, contactors, loop = self._delays, self.contactors, Loop(self.ticks, deadline_misses)
        tick_ns = self.states[0].now_ns
        forces_n = [state.felt_n for state in self.states]
        samples = [account.counts() for account in self.receiver.accounts()]
        samples = samples or [SampleCounts()] * len(contactors)
        summary = replace(
            self.receiver.summary(tick_ns),
            playout_delay_ms=delays.playout_delay_ms,
            covered_delay_ms=delays.covered_delay_ms,
            availability=self._availability.availability(delays.ticks),
            interruptions=self._interruptions.interruptions(),
            compensation=delays.compensation(may_trust=self._playout.trust is not None),
            announce=self._announcement.figures() if self._announcement else AnnounceFigures(),
            loop=loop,
            press=PressFigures() if self.press is None else self.press.figures(),
            rejected=dict(self.receiver.rejected),
            faults=list(self.fade.faults),
            notes=[note for each in contactors for note in each.notes],
        )
        played_s = delays.ticks * self._tick_ns * 1e-9
        figures = dict[str, Summary]()
        for each, counts, felt_n in zip(contactors, samples, forces_n, strict=True):
            yield
            figures[each.name] = each.summary(counts, loop, played_s, felt_n, now_ns or tick_ns)
        yield
        return with_contactors(summary, figures)
