"""Taps of a soak: displays' telemetry and terminals, and all frames of a sensing node.

The frames are received beside the sensing node, where no link delays or loses them. For a killed
node, only they show the number of samples that it had sent.
"""

import asyncio
import time
from collections.abc import Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field

import zmq
import zmq.asyncio

from protocol.errors import WireError
from protocol.host.child_process import python_command
from protocol.security.link_keys import ClientKeys
from protocol.wire.messages import decode_frame
from protocol.wire.telemetry import STATUS, TRACE, read_status, read_trace, unpack
from soak.accounts import Mark
from soak.claims import LineClaim, StatusClaim, no_figures, read_line
from soak.core_time import read_core_time
from soak.felt import FeltLog
from soak.processes import SoakProcess
from tests.support.netem import Namespace

RECONNECT_MS = 20
HIGH_WATER = 10_000
RENEW_AFTER_MS = 300
# A stopped display ends its terminal; another is opened for the next display.
AGAIN_AFTER_S = 0.2


async def end_tasks(tasks: Sequence["asyncio.Task[None]"]) -> None:
    """End tasks that run for ever. Raises the error of one that has failed."""
    for task in tasks:
        task.cancel()
    for end in await asyncio.gather(*tasks, return_exceptions=True):
        if not isinstance(end, asyncio.CancelledError) and end is not None:
            raise end


@dataclass(slots=True)
class SessionFrames:
    """Frames of a session: time of its first sample, samples per frame, samples and last time."""

    began_ns: int
    period_ns: int
    batch: int
    sent: int
    last_ns: int


@dataclass(slots=True)
class Taps:
    """Ticks by a display's role, and frames by a sensing node's role and session."""

    felt: dict[str, FeltLog] = field(default_factory=dict)
    sessions: dict[str, dict[int, SessionFrames]] = field(default_factory=dict)
    _tasks: list[asyncio.Task[None]] = field(default_factory=list)
    _contexts: list[zmq.asyncio.Context] = field(default_factory=list)

    def follow_display(
        self, role: str, address: str, nodes: dict[str, SoakProcess], tick_ns: int
    ) -> None:
        """Record a display's telemetry, for the present process of its role."""
        self.felt[role] = FeltLog(tick_ns)
        socket = self._subscribe(address, (TRACE, STATUS))
        self._tasks.append(asyncio.create_task(self._record_display(socket, role, nodes)))

    def follow_sensing(
        self, role: str, address: str, namespace: Namespace | None, keys: ClientKeys | None
    ) -> None:
        """Record all frames of a sensing node."""
        self.sessions[role] = {}
        socket = self._subscribe(address, (b"",), namespace, keys)
        self._tasks.append(asyncio.create_task(self._record_frames(socket, address, role)))

    async def close(self) -> None:
        """End recording. Raises the errors of the recording tasks."""
        try:
            await end_tasks(self._tasks)
        finally:
            for context in self._contexts:
                context.destroy(linger=0)

    def _subscribe(
        self,
        address: str,
        topics: Sequence[bytes],
        namespace: Namespace | None = None,
        keys: ClientKeys | None = None,
    ) -> zmq.asyncio.Socket:
        # ZeroMQ's threads start with a context's first socket, and stay in its namespace.
        with namespace.entered() if namespace is not None else nullcontext():
            context = zmq.asyncio.Context()
            self._contexts.append(context)
            socket = context.socket(zmq.SUB)
        socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
        socket.setsockopt(zmq.RCVHWM, HIGH_WATER)
        if keys is not None:
            keys.protect(socket)  # type: ignore[arg-type]
        for topic in topics:
            socket.subscribe(topic)
        socket.connect(address)
        return socket

    async def _record_display(
        self, socket: zmq.asyncio.Socket, role: str, nodes: dict[str, SoakProcess]
    ) -> None:
        felt, process = self.felt[role], None
        while True:
            topic, data, *_ = await socket.recv_multipart()
            node, now_ns = nodes[role], time.perf_counter_ns()
            if node.process is not process:
                process = node.process
                felt.begin_process()
            if topic == TRACE:
                felt.add_trace(read_trace(data)[0])
                core_time = read_core_time(process.pid, now_ns)
                node.core_times += [] if core_time is None else [core_time]
            elif topic == STATUS:
                _take_status(data, node, felt, now_ns)

    async def _record_frames(self, socket: zmq.asyncio.Socket, address: str, role: str) -> None:
        sessions = self.sessions[role]
        while True:
            if not await socket.poll(RENEW_AFTER_MS):
                # ZeroMQ does not connect again after a handshake with an impostor without keys.
                socket.disconnect(address)
                socket.connect(address)
                continue
            data = await socket.recv()
            try:
                frame = decode_frame(data)
            except WireError:
                continue  # of an impostor
            began_ns = frame.t_first_ns - frame.first_sample * frame.period_ns
            count = len(frame.values)
            session = sessions.setdefault(
                frame.session, SessionFrames(began_ns, frame.period_ns, count, count, 0)
            )
            session.sent = max(session.sent, frame.first_sample + len(frame.values))
            session.last_ns = time.perf_counter_ns()


def _take_status(data: bytes, node: SoakProcess, felt: FeltLog, now_ns: int) -> None:
    """Store a status, with the ticks up to its arrival."""
    status = read_status(data)
    samples = status.summary["samples"]
    total = (samples["sent"] or 0) + (samples["before_joining"] or 0)
    node.marks.append(Mark(now_ns, status.state, total))
    node.summary = status.summary
    if felt.last is not None:
        claim = StatusClaim(
            *(now_ns, *felt.last, felt.ticks, felt.full),
            state=status.state,
            final=status.final,
            summary=status.summary,
            no_figures=tuple(no_figures(unpack(data))),
        )
        node.claims.append(claim)


@dataclass(slots=True)
class Terminals:
    """Terminals of displays. lines: the lines shown, by the display's role."""

    lines: dict[str, list[LineClaim]] = field(default_factory=dict)
    _tasks: list[asyncio.Task[None]] = field(default_factory=list)

    def open(self, role: str, address: str) -> None:
        """Show a display's telemetry in a process, as `display-node` does itself.

        The process is started here and not by the display, so that it outlives a killed one.
        """
        self.lines[role] = []
        self._tasks.append(asyncio.create_task(self._show(role, address)))

    async def close(self) -> None:
        """End all terminals. Raises the errors of reading them."""
        await end_tasks(self._tasks)

    async def _show(self, role: str, address: str) -> None:
        while True:
            process = await asyncio.create_subprocess_exec(
                *python_command("-m", "display_node.telemetry.terminal", address),
                stdout=asyncio.subprocess.PIPE,
                start_new_session=True,
            )
            try:
                await self._read(process, role)
            except asyncio.CancelledError:
                with suppress(ProcessLookupError):
                    process.kill()
                raise
            finally:
                await process.wait()
            await asyncio.sleep(AGAIN_AFTER_S)

    async def _read(self, process: asyncio.subprocess.Process, role: str) -> None:
        assert process.stdout is not None
        async for data in process.stdout:
            claim = read_line(data.decode("utf-8", "replace").rstrip("\n"), time.perf_counter_ns())
            if claim is not None:
                self.lines[role].append(claim)
