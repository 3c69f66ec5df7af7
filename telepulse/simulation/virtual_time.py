"""Both nodes and the link between them in virtual time: the nodes' modules, without sockets.

source → frames → wire bytes → link → display, one event after the other. With ticks from a real
clock, a simulation runs a display in real time over the modelled link.
"""

import heapq
import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final

from display_node.display import Display
from display_node.hardware import Hardware
from protocol.summary.fields import DataConnections, Summary, with_sensing_node
from protocol.ticks import TickBlock, TickState
from protocol.wire.messages import (
    Bye,
    ControlMessage,
    Frame,
    ProbeReport,
    SetPoint,
    encode_control,
    encode_frame,
)
from pulse_sensors.sample_plausibility import SampleCheck
from sensing_node.control_server import ControlServer
from sensing_node.feeds import Framer, PacedFeed, probe_faults, sensor_notes
from sensing_node.scene import build_source, describe_stream, serve_set_points
from telepulse.scene import Scene
from telepulse.simulation.link_model import MessageLink
from telepulse.simulation.true_errors import TrueErrors

# The sensing clock is ahead by this, so that a confusion of the two clocks shows at once.
SENSING_CLOCK_AHEAD_NS: Final = 3_600_000_000_000
STREAM_BEGINS_NS: Final = 500_000_000
SENDER = (b"simulated display",)
DRAIN_LIMIT_NS: Final = 15_000_000_000

# Takes a message's bytes, and the time in ns.
Handler = Callable[[bytes, int], None]


class Simulation:
    """One run of a scene in virtual time; the same scene and seed give the same summary.

    begin_ns: time of the display's clock at which the simulation starts. hardware: a real bench to
    play on, for a display with one contactor. take_frame: receives each frame that is sensed, with
    the true values. source: the pulse at the wrist. set_points: their server there; None where none
    are taken.

    Raises SceneError for a force loop that is not stable. Raises SourceError for a source that
    cannot be built.
    """

    def __init__(
        self,
        scene: Scene,
        seed: int,
        begin_ns: int = 0,
        hardware: Hardware | None = None,
        take_frame: Callable[[Frame], None] | None = None,
    ) -> None:
        self._scene, self._take_frame = scene, take_frame
        self.source = build_source(scene.sensing, scene.path.parent)
        self._description = describe_stream(scene.sensing, self.source)
        self._errors = TrueErrors(scene, self._description, real_benches=hardware is not None)
        self._now_ns = begin_ns
        self._stream_ns = begin_ns + STREAM_BEGINS_NS
        self._judged_from_ns = self._last_ns = self._stream_ns
        self._paced = PacedFeed(self.source, self._stream_ns + SENSING_CLOCK_AHEAD_NS)
        self._session = seed + 1
        self._framer = Framer(self._description, self._session)
        self._check = SampleCheck(self._description.period_ns, self._description.channels)
        self.set_points = serve_set_points(self.source, self._session)
        self._control_server = ControlServer(self._description, self._session, self.set_points)
        self.display = Display(scene.display, "simulated display", score=False)
        self.display.take_ticks = self._judge
        if hardware is not None:
            self.display.use(hardware)
        self._down = MessageLink(scene.link, seed, begin_ns)
        self._up = MessageLink(scene.link, seed + 1, begin_ns)
        self._batch = self._description.batch
        # Data connections, each with losses of its own. As datagrams, a stream has none, and one
        # copy of each frame is sent.
        self._paths = scene.display.paths if scene.link.transport == "tcp" else 1
        self.display.receiver.paths = self._paths
        self._events: list[tuple[int, int, Handler, bytes]] = []
        self._order = itertools.count()

    def run(
        self,
        seconds: float,
        settle_seconds: float = 0.0,
        watch: Callable[[TickState], None] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Summary:
        """Simulate `seconds` of stream, until its last sample is played.

        Ticks before the stream is `settle_seconds` old are not judged. `watch` receives every
        judged tick until the stream ends. `progress` receives the simulated time in s at each tick.
        """
        began_s, begin_ns = time.perf_counter(), self._now_ns
        for state in self.ticks(seconds, settle_seconds):
            if watch and state.full and self._judged_from_ns <= self._now_ns <= self._last_ns:
                watch(state)
            if progress is not None:
                progress((self._now_ns - begin_ns) * 1e-9)
        speed = (self._now_ns - begin_ns) / 1e9 / (time.perf_counter() - began_s)
        return replace(self.end(), speed=speed)

    def ticks(self, seconds: float, settle_seconds: float = 0.0) -> Iterator[TickState]:
        """Simulate `seconds` of stream, and yield the state after each tick."""
        last_ns, tick_ns = self.begin(seconds, settle_seconds), self._scene.display.tick_ns
        while not self.display.over and self._now_ns < last_ns + DRAIN_LIMIT_NS:
            yield self.tick(self._now_ns + tick_ns)

    def begin(self, seconds: float, settle_seconds: float = 0.0) -> int:
        """Begin `seconds` of stream; return the time in ns at which its last sample is due.

        The felt force is judged once the stream is `settle_seconds` old.
        """
        self._judged_from_ns = self._stream_ns + round(settle_seconds * 1e9)
        self._last_ns = self._stream_ns + round(seconds * 1e9) - 1
        self._schedule_batch()
        return self._last_ns

    def tick(self, now_ns: int, elapsed_ticks: int = 1) -> TickState:
        """Process the events that are due, and tick the display."""
        self._now_ns, events = now_ns, self._events
        while events and events[0][0] <= now_ns:
            at_ns, _, event, data = heapq.heappop(events)
            event(data, at_ns)
        # In virtual time, work takes none.
        while self.display.work():
            pass
        state = self.display.tick(now_ns, elapsed_ticks)
        for message in self.display.requests(now_ns):
            self._send(self._up, now_ns, self._answer, message)
        return state

    def end(self) -> Summary:
        """Score the remaining ticks, and return the summary."""
        self.display.finish_scores()
        display = self._errors.finish(self.display.summary())
        sensing = Summary(
            limited=self.source.limits(),
            faults=probe_faults(self.source),
            notes=sensor_notes(self.source, self._check),
        )
        clock = display.clock
        if clock.offset_ms is not None:
            # The true offset is known: report the error of the estimate.
            clock = replace(clock, offset_ms=clock.offset_ms - SENSING_CLOCK_AHEAD_NS * 1e-6)
        whole = with_sensing_node(display, sensing)
        return replace(whole, clock=clock, data_connections=DataConnections(self._paths))

    @property
    def lost_frames(self) -> int:
        """Count of data frames that the link has lost."""
        return self._down.lost_data

    def _schedule_batch(self) -> None:
        """Schedule the next batch, which may be short at the end; after the last, a bye."""
        paced, last_ns = self._paced, self._last_ns
        if paced.exhausted or paced.due_ns(1) - SENSING_CLOCK_AHEAD_NS > last_ns:
            bye = Bye(self._session, self._framer.next_sample)
            self._send(self._down, last_ns, self.display.on_control, bye)
        else:
            due_ns = paced.due_ns(self._batch) - SENSING_CLOCK_AHEAD_NS
            self._schedule(min(due_ns, last_ns), self._sense, b"")

    def _sense(self, _: bytes, now_ns: int) -> None:
        block = self._paced.read(now_ns + SENSING_CLOCK_AHEAD_NS)
        if block is not None:
            self._check.add(block.values)
            for frame in self._framer.frames(block):
                true_frame = self._errors.add_sent(frame)
                if self._take_frame is not None:
                    self._take_frame(true_frame)
                data = encode_frame(frame)
                for path in range(self._paths):
                    arrival_ns = self._down.data_arrival_ns(now_ns, len(data), path)
                    if arrival_ns is not None:
                        self._schedule(arrival_ns, self.display.on_frame, data)
        self._schedule_batch()

    def _judge(self, block: TickBlock) -> None:
        """Compare the felt forces of a block of ticks with the true pulse."""
        ticks = block.columns
        judged = (ticks.full != 0) & (ticks.now_ns >= self._judged_from_ns)
        forces_n = [block.felt_n(place)[judged] for place in range(len(self.display.contactors))]
        now_ns, instant_ns = ticks.now_ns[judged], ticks.instant_ns[judged]
        true_now_ns = now_ns + SENSING_CLOCK_AHEAD_NS
        self._errors.add_felt(now_ns, true_now_ns, instant_ns, forces_n)

    def _answer(self, data: bytes, now_ns: int) -> None:
        sensing_now_ns = now_ns + SENSING_CLOCK_AHEAD_NS
        reply = self._control_server.answer(SENDER, data, sensing_now_ns, self._framer.next_sample)
        if reply is not None:
            self._send(self._down, now_ns, self.display.on_control, reply)

    def _send(
        self, link: MessageLink, now_ns: int, deliver: Handler, message: ControlMessage
    ) -> None:
        data = encode_control(message)
        may_be_lost = isinstance(message, SetPoint | ProbeReport)
        arrives = link.press_arrival_ns if may_be_lost else link.control_arrival_ns
        arrival_ns = arrives(now_ns, len(data))
        if arrival_ns is not None:
            self._schedule(arrival_ns, deliver, data)

    def _schedule(self, at_ns: int, event: Handler, data: bytes) -> None:
        heapq.heappush(self._events, (at_ns, next(self._order), event, data))
