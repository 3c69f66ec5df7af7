"""The server of metrics: hears a node's telemetry, answers Prometheus.

Where metrics are served: [ADDRESS:]PORT.
"""

import re
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import zmq

from display_node.telemetry.age import TelemetryAge
from display_node.telemetry.terminal import TerminalView
from protocol import sockets
from protocol.errors import AddressError, SidecarError, WireError
from protocol.security.keys import ClientKeys, read_pair
from protocol.wire.status import STATUS, read_status
from protocol.wire.telemetry import TRACE, read_trace
from telepulse.metrics.http import MetricsHTTPServer

LOOPBACK = "127.0.0.1"
MAX_PORT = 65_535
_WHERE = re.compile(r"(?:(?P<host>\[[0-9A-Fa-f:.]+\]|[^\s:\[\]]+):)?(?P<port>[0-9]{1,5})")


def parse_address(text: str) -> tuple[str, int]:
    """Host and port; without a host, this machine alone. Raises AddressError."""
    match = _WHERE.fullmatch(text)
    if match is None or int(match["port"]) > MAX_PORT:
        raise AddressError(
            f"--metrics {text}: not a port; write 9100, or ADDRESS:9100 for other machines"
        )
    return (match["host"] or LOOPBACK).strip("[]"), int(match["port"])


try:
    from prometheus_client import CollectorRegistry, make_wsgi_app
    from prometheus_client.metrics_core import Metric
    from prometheus_client.registry import Collector

    from telepulse.metrics.families import NodeState, families
except ImportError as error:
    raise SidecarError(
        f"metrics need prometheus_client, which cannot be loaded ({error});"
        " pip install 'telepulse[metrics]'"
    ) from None

WAIT_NS = 1_000_000_000


class Server(Collector):
    """Answers from the moment it is made, of a node that it follows once told which.

    url: where it answers.
    """

    def __init__(self, program: str, host: str, port: int) -> None:
        """Raises AddressError where that cannot be bound."""
        self._program = program
        self._told: NodeState | None = None
        self._unreadable = 0
        registry = CollectorRegistry()
        registry.register(self)
        try:
            server = MetricsHTTPServer(host, port, make_wsgi_app(registry))
        except OSError as error:
            where = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
            raise AddressError(f"--metrics: cannot bind {where}: {error.strerror}") from None
        threading.Thread(target=server.serve_forever, daemon=True).start()
        host = f"[{host}]" if ":" in host else host
        self.url = f"http://{host}:{server.server_port}/metrics"

    def collect(self) -> Iterator[Metric]:
        """The metrics now, for a request; any thread may ask."""
        yield from families(self._program, self._told, time.monotonic_ns(), self._unreadable)

    def follow(self, address: str, key: str | None) -> None:
        """Hear a node's telemetry, without end."""
        pair = read_pair(Path(key)) if key else None
        context: sockets.Context = zmq.Context()
        keys = ClientKeys(pair, pair.public) if pair else None
        socket = sockets.connect(context, zmq.SUB, address, keys)
        for topic in (STATUS, TRACE):
            socket.subscribe(topic)
        screen = TerminalView()
        age = TelemetryAge(local=not sockets.beyond_loopback(address))
        while True:
            sockets.wait_readable([socket], WAIT_NS)
            for message in sockets.receive_all(socket):
                try:
                    self._take(screen, age, *message)
                except (WireError, TypeError):
                    self._unreadable += 1

    def _take(self, screen: TerminalView, age: TelemetryAge, topic: bytes, data: bytes) -> None:
        now_ns = time.monotonic_ns()
        if topic == TRACE:
            trace = read_trace(data)
            screen.add_trace(trace)
            if len(trace.now_ns):
                age.take_trace(int(trace.now_ns[-1]), now_ns)
        elif topic == STATUS:
            status = read_status(data)
            age.take_status(now_ns)
            sent_ns = now_ns - (age.age_ns(now_ns) or 0)
            self._told = NodeState(status, sent_ns, screen.heart_rate_per_min)
