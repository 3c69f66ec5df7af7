"""The display node's shell: sockets, the monotonic clock, and one real-time loop."""

import logging
import secrets
import time
import uuid
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from dataclasses import replace

import zmq

from display_node.display import Display
from display_node.hardware import Hardware
from display_node.press.sweep import DepthSweep
from display_node.reception.connection import Connection
from display_node.scene import DisplayScene
from display_node.scoring.deadlines import GAP_NS, DeadlineWatch
from display_node.telemetry.alerts import WITHOUT_SAMPLES
from display_node.telemetry.publisher import Publisher
from protocol import sockets
from protocol.faults import Part, internal_fault
from protocol.histogram import Histogram
from protocol.host.output import FAULT
from protocol.host.realtime import Pacer
from protocol.pieces import Pieces, complete
from protocol.refusals import Reason
from protocol.security.authenticator import Authenticator
from protocol.security.link_keys import ClientKeys, ServerKeys
from protocol.summary.fields import Lateness, Summary, TickTime
from protocol.wire.messages import encode_control
from protocol.wire.telemetry import CONTROL
from pulse_sensors.sensor import Sensor

logger = logging.getLogger(__name__)

# Messages read from each connection per tick, even if the tick is late: a host that is always late
# still receives the whole stream.
LEAST_READ = 16
# Between two ticks, work that no command waits for is done in pieces. None begins within this part
# of a tick before the next one. A host that has no such time does one piece for each such time.
RESERVE_PARTS = 4
PIECE_EVERY_NS = 1_000_000
# Least expected time between two frames once a stream has ended, when silence is normal.
ENDED_NS = 1_000_000_000


class DisplayNode:
    """A display on real sockets. One thread waits for messages until the next tick, then ticks.

    addresses: of the one sensing node, one for each network path. keys: the sensing node's public
    key and this node's pair. telemetry_keys: this node's pair and the allow-list of the telemetry's
    readers; None admits every peer that can reach the socket. provenance: of this run, for
    recorders. telemetry: its publisher. Raises SceneError for a force loop that is not stable, and
    AddressError for an address that cannot be used.
    """

    def __init__(
        self,
        scene: DisplayScene,
        addresses: Sequence[str],
        telemetry_address: str,
        keys: ClientKeys | None = None,
        telemetry_keys: ServerKeys | None = None,
        provenance: bytes = b"",
    ) -> None:
        self._scene = scene
        # First, because a loop that is not stable is refused here, before any socket is opened.
        name = f"display-{uuid.uuid4().hex[:6]}"
        self._display = Display(scene, name, press=secrets.randbits(62))
        self._benches: list[Hardware | None] = [None] * len(self._display.contactors)
        self._stopping = False
        self._sweep: DepthSweep | None = None
        self._pacer = Pacer(scene.tick_ns, time.perf_counter_ns())
        drives = (contactor.drive for contactor in scene.contactors)
        watchdogs_ns = [drive.watchdog_ns for drive in drives if drive is not None]
        self._deadlines = DeadlineWatch(scene.tick_ns, min(watchdogs_ns, default=GAP_NS))
        self._publishing = Pieces()
        self._command_us, self._tick_us = Histogram(1.0, 5_000), Histogram(1.0, 5_000)
        self._late_us = Histogram(2.0, 2_500)
        self._named_faults = 0
        self._warned: set[str] = set()
        self._context: sockets.Context = zmq.Context()
        try:
            paths = self._display.receiver.paths = max(scene.paths, len(addresses))
            turns = 0 if scene.press is None else scene.press.connections
            self._connection = Connection(self._context, addresses, paths, keys, turns)
            readers = Authenticator(self._context, telemetry_keys)
            telemetry = sockets.bind(self._context, zmq.XPUB, telemetry_address, readers)
            self.telemetry = Publisher(telemetry, secrets.randbits(62), readers, provenance)
        except BaseException:
            self.close()
            raise
        self._display.take_ticks = self.telemetry.trace.add
        self.telemetry_address = self.telemetry.address

    def use(self, *benches: Hardware | None) -> None:
        """Play on started real benches instead of the scene's models. Call it before `run`.

        benches: in the contactors' order; None leaves a contactor its model.
        """
        self._benches = list(benches)
        self._display.use(*benches)

    def use_press(self, sensor: Sensor) -> None:
        """Read the finger's press from a live sensor. Call it before `run`."""
        if self._display.press is not None:
            self._display.press.use(sensor)

    def sweep_with(self, sweep: DepthSweep) -> None:
        """Press as a sweep does instead of a finger, until it is over. Call it before `run`."""
        if self._display.press is not None:
            self._display.press.sweep_with(sweep)
            self._sweep = sweep

    def stop(self) -> None:
        """End the loop after the present tick."""
        self._stopping = True

    @property
    def stopped(self) -> bool:
        """True after `stop`: the run did not end by itself."""
        return self._stopping

    def close(self) -> None:
        """Close the sockets of a node that did not run; after `run` they are closed already."""
        self._context.destroy(linger=0)

    def run(self, seconds: float | None = None, once: bool = False) -> Summary:
        """Run the loop until `stop`, for `seconds`, or with `once` to the end of the stream.

        An exception that no code expects ends the loop as a fault: the tips are withdrawn, and the
        last status and the summary have it.
        """
        try:
            try:
                self._loop(seconds, once)
            except Exception as error:
                self._take_error(error)
            return self._finish()
        finally:
            self._connection.close()
            self._context.destroy(linger=sockets.LINGER_MS)

    def _loop(self, seconds: float | None, once: bool) -> None:
        start_ns = time.perf_counter_ns()
        end_ns = None if seconds is None else start_ns + round(seconds * 1e9)
        pacer = self._pacer = Pacer(self._scene.tick_ns, start_ns)
        reserve_ns, rested, arrived = self._scene.tick_ns // RESERVE_PARTS, True, True
        descriptors = self._connection.descriptors
        while not self._stopping:
            woke_ns = time.perf_counter_ns()
            # After a wait in which nothing has arrived, to read would only delay the command.
            if arrived:
                self._receive(pacer.due_ns)
            now_ns, arrived = time.perf_counter_ns(), True
            tick = pacer.begin(now_ns)
            if tick is None:
                spare_ns = pacer.due_ns - now_ns
                rested = rested or spare_ns > reserve_ns
                if spare_ns <= reserve_ns or not self._work():
                    arrived = sockets.wait_on_descriptors(descriptors, spare_ns)
                continue
            felt = self._display.fade.gain > 0.0
            self._display.command(tick.due_ns, tick.elapsed_ticks)
            self._command_us.add((time.perf_counter_ns() - woke_ns) * 1e-3)
            self._late_us.add(tick.late_ns * 1e-3)
            # Ticks that are late while nothing is felt alarm nobody.
            self._deadlines.add(now_ns, tick.elapsed_ticks if felt else 1)
            self._account(tick.due_ns, tick.elapsed_ticks)
            self._tick_us.add((time.perf_counter_ns() - now_ns) * 1e-3)
            if not rested:
                self._work_anyway()
            rested = False
            if (end_ns is not None and now_ns >= end_ns) or (once and self._display.over):
                break

    def _take_error(self, error: Exception) -> None:
        """Latch an exception of the loop, and begin to withdraw."""
        fault = internal_fault(Part.LOOP, "loop", error, time.perf_counter_ns())
        self._display.fade.fault(fault)
        for hardware in self._benches:
            if hardware is not None:
                hardware.begin_withdrawal()
        logger.error(f"fault: {fault}: {fault.remedy}", extra={FAULT: True})
        logger.debug("the loop has ended", exc_info=error)

    def _receive(self, until_ns: int) -> None:
        """Take the waiting messages, at most until `until_ns`; the next call takes the rest."""
        display, connection, captured = self._display, self._connection, self.telemetry.captured
        receiver = display.receiver
        for path, route in enumerate(connection.routes):
            before, _ = receiver.frames
            for number, message in enumerate(route.messages()):
                now_ns = time.perf_counter_ns()
                display.on_frame(message, now_ns)
                captured.add(now_ns, path, message)
                if now_ns >= until_ns and number >= LEAST_READ:
                    break
            route.frames_first += receiver.frames[0] - before
        for number, message in enumerate(connection.control_messages()):
            now_ns, sessions = time.perf_counter_ns(), receiver.sessions
            display.on_control(message, now_ns)
            captured.add(now_ns, CONTROL, message)
            if receiver.sessions > sessions:
                captured.welcome(now_ns, message)
            if now_ns >= until_ns and number >= LEAST_READ:
                break
        if receiver.accepts_frames and receiver.description is not None:
            frame_ns = receiver.description.batch * receiver.description.period_ns
            if receiver.buffer.ended:
                frame_ns = max(frame_ns, ENDED_NS)
            round_trip_ns = 2 * receiver.clock.asymmetry_bound_ns
            connection.subscribe(frame_ns, round_trip_ns, time.perf_counter_ns())

    def _account(self, due_ns: int, elapsed_ticks: int) -> None:
        """Count a tick that was commanded at `due_ns`; log, request and publish what is due."""
        self._display.move()
        self._display.account(elapsed_ticks)
        if self._sweep is not None and self._sweep.over:
            self.stop()
        faults = self._display.fade.faults
        for fault in faults[self._named_faults :]:
            logger.error(f"fault: {fault}: {fault.remedy}", extra={FAULT: True})
        self._named_faults = len(faults)
        for reason in (self._display.receiver.other_version, self._display.receiver.false_report):
            if reason and reason not in self._warned:
                self._warned.add(reason)
                logger.warning(f"refused: {reason}")
        if self._connection.poll(due_ns):
            self._display.receiver.introduce()
        requested_ns = time.perf_counter_ns()
        for message in self._display.requests(requested_ns):
            control = self._connection.control_for(message, requested_ns)
            sockets.send(control, encode_control(message))
        if self.telemetry.trace.waiting and not self._publishing.waiting:
            self._publishing.begin(self._publish())

    def _work(self) -> bool:
        """Do one piece of the work that no command waits for; return whether there was any."""
        return self._display.work() or self._publishing.do_one()

    def _work_anyway(self) -> None:
        """Do a tick's least share of that work, on a host that has no time for it."""
        for _ in range(max(1, self._scene.tick_ns // PIECE_EVERY_NS)):
            self._display.work()
        self._publishing.do_one()

    def _publish(self) -> Iterator[None]:
        """Publish the last ticks, and a status where it is due, piece by piece."""
        # State and first figures are those of the last published tick, whose time a status has.
        self._display.close_block()
        state = self._display.state
        if self.telemetry.publish():
            summary = yield from self._summary_pieces()
            yield
            self.telemetry.status(self._display.pack_status(summary, False, state))

    def _summary_pieces(self) -> Generator[None, None, Summary]:
        """Build the display's summary with the figures of this shell, piece by piece."""
        connection, deadlines, late_us = self._connection, self._deadlines, self._late_us
        now_ns = time.perf_counter_ns()
        summary = yield from self._display.summary_pieces(self._pacer.missed, now_ns)
        yield
        lateness = late_us.quantiles(p50=0.5, p99=0.99, p999=0.999)
        commands, ticks = (
            TickTime(**times_us.quantiles(p50=0.5, p99=0.99))
            for times_us in (self._command_us, self._tick_us)
        )
        yield
        routes = connection.routes if len(connection.routes) > 1 else ()
        first = {route.address: route.frames_first for route in routes}
        return replace(
            summary,
            frames=replace(summary.frames, first=first),
            loop=replace(
                summary.loop,
                command_us=commands,
                tick_us=ticks,
                late_us=Lateness(**lateness, max=late_us.maximum),
                late=deadlines.alarm,
                last_5s=deadlines.last_5s,
                worst_5s=deadlines.worst_5s,
            ),
            rejected=dict(Counter(summary.rejected) + connection.rejected),
            notes=[*summary.notes, *self.telemetry.notes],
            rejected_readers=dict(self.telemetry.rejected),
            reconnections=connection.reconnections,
            data_connections=connection.data_connections,
            refused=connection.refused,
            waiting_for=self._waiting_for(),
        )

    def _waiting_for(self) -> list[Reason]:
        """Return what the display waits for while it has no stream to play."""
        state, description = self._display.state, self._display.receiver.description
        connection, now_ns = self._connection, time.perf_counter_ns()
        if state not in WITHOUT_SAMPLES:
            return []
        is_ready = connection.refused is None and connection.has_data_link(now_ns)
        if state == "waiting" and description is not None and is_ready:
            return [Reason(f"the first samples of {description.name!r}")]
        return connection.waiting_for(now_ns)

    def _finish(self) -> Summary:
        if (leaving := self._display.receiver.leave()) is not None:
            control = self._connection.control_for(leaving, time.perf_counter_ns())
            sockets.send(control, encode_control(leaving))
        benches = [hardware for hardware in self._benches if hardware is not None]
        # All at once: a drive that waits for the others would report a missing command.
        for hardware in benches:
            hardware.begin_withdrawal()
        for contactor, bench in zip(self._display.contactors, self._benches, strict=True):
            if bench is not None and (fault := bench.withdraw()) is not None:
                contactor.latch(fault, self._display.fade)
        self._display.finish_scores()
        summary = complete(self._summary_pieces())
        self.telemetry.finish(self._display.pack_status(summary, final=True))
        return summary
