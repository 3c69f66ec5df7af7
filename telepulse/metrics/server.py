"""Server of a node's metrics: reads the node's telemetry, answers Prometheus over HTTP.

Figures have Prometheus's names and base units.
"""

import re
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from socketserver import TCPServer, ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer
from wsgiref.types import StartResponse, WSGIApplication, WSGIEnvironment

import zmq

from display_node.telemetry.status_age import StatusAge
from display_node.telemetry.terminal_view import TerminalView
from protocol import sockets
from protocol.errors import AddressError, SidecarError, WireError
from protocol.security.link_keys import KeyOptions
from protocol.summary.fields import contactors_of
from protocol.summary.figures import Figure, Surface, figures_on
from protocol.summary.phrases import COUNT
from protocol.wire.telemetry import STATUS, TRACE, Status, read_status, read_trace
from telepulse.http_site import Site, in_url

try:
    from prometheus_client import CollectorRegistry, make_wsgi_app
    from prometheus_client.metrics_core import (
        GaugeMetricFamily,
        InfoMetricFamily,
        Metric,
        StateSetMetricFamily,
    )
    from prometheus_client.registry import Collector
except ImportError as error:
    raise SidecarError(
        f"metrics need prometheus_client, which cannot be loaded ({error});"
        " pip install 'telepulse[metrics]'"
    ) from None

PREFIX = "telepulse_"
# A node counts as silent after this time: short stalls are not reported.
SILENT_AFTER_NS = 5_000_000_000
STATES = ("waiting", "starting", "playing", "stale", "ended", "fault", "streaming")
_NUMBER = re.compile(r"\d+(\.\d+)?")


@dataclass(frozen=True, slots=True)
class NodeState:
    """Last status of a node.

    sent_ns: when the node sent it, on this process's clock. heart_rates_per_min: of the pulse that
    is felt, of each contactor of a display.
    """

    status: Status
    sent_ns: int
    heart_rates_per_min: Sequence[float | None] = ()


def families(
    program: str, node: NodeState | None, now_ns: int, unreadable: int = 0
) -> Iterator[Metric]:
    """Yield the metrics at `now_ns`; for a silent node only the age of its last status."""
    silent = node is None or now_ns - node.sent_ns > SILENT_AFTER_NS
    yield _gauge("up", "1: the node sends statuses; 0: silent for 5 s.", not silent)
    misread = Metric(PREFIX + "unreadable_statuses", "Statuses that could not be read.", "counter")
    misread.add_sample(misread.name + "_total", {}, unreadable)
    yield misread
    if node is None:
        return
    status = node.status
    yield _gauge("status_age_seconds", "Age of the figures.", (now_ns - node.sent_ns) * 1e-9)
    words = {"program": program, "version": version("telepulse"), "stream": status.stream}
    # As text: Prometheus's numbers are floats, which cannot represent 63 bits.
    words["session"] = "" if status.session is None else f"{status.session:x}"
    yield InfoMetricFamily(PREFIX + "node", "The node and its stream.", words)
    if silent:
        return
    known = {name: name == status.state for name in (*STATES, status.state)}
    yield StateSetMetricFamily(PREFIX + "state", "State of the node.", known)
    if status.state == "playing":
        heart_rates = _heart_rates(contactors_of(status.summary), node.heart_rates_per_min)
        if heart_rates.samples:
            yield heart_rates
    if status.displays is not None:
        yield _gauge("displays", "Displays that are connected.", status.displays)
    # Prometheus requires all samples of a name in one group, with one help text.
    found: dict[str, Metric] = {}
    help_texts: dict[str, str] = {}
    for figure in figures_on(Surface.METRICS):
        help_text = help_texts.setdefault(figure.metric, figure.help or figure.meaning)
        # The node's, then those of each of several contactors.
        samples = list(_samples(figure, status.summary))
        for contactor, figures in status.summary["contactors"].items():
            of_it = {"contactor": contactor}
            samples += [(labels | of_it, value) for labels, value in _samples(figure, figures)]
        for labels, value in samples:
            name = PREFIX + figure.metric
            metric = found.setdefault(name, Metric(name, help_text, figure.metric_type))
            metric.add_sample(name + ("_total" if figure.counter else ""), labels, value)
    yield from found.values()


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(PREFIX + name, text, value=value)


def _heart_rates(contactors: Iterable[str], rates_per_min: Iterable[float | None]) -> Metric:
    name = PREFIX + "heart_rate_hertz"
    found = Metric(name, "Heart rate of the pulse that is felt.", "gauge")
    # Traces and statuses of a display that was restarted may have other contactors.
    for contactor, rate_per_min in zip(contactors, rates_per_min, strict=False):
        if rate_per_min is not None:
            found.add_sample(name, {"contactor": contactor} if contactor else {}, rate_per_min / 60)
    return found


def _samples(figure: Figure, summary: Mapping[str, Any]) -> Iterator[tuple[dict[str, str], float]]:
    value = figure.value(summary)
    if isinstance(value, dict):
        for name, count in value.items():
            yield {figure.label: name}, count
    elif isinstance(value, str | list):
        texts: list[Any] = [value] if value and isinstance(value, str) else list(value)
        labels = [
            {key: each[key] for key in figure.keys} if figure.keys else {figure.label: each}
            for each in texts
        ]
        # Without their numbers, each of which would be a new label.
        rows = {tuple((key, _NUMBER.sub("#", text)) for key, text in x.items()) for x in labels}
        for row in sorted(rows):
            yield dict(row), 1
    elif value is not None:
        yield dict(figure.labels), value * (figure.unit or COUNT).base


# A scrape takes some 10 ms. A peer that sends no request, or does not read, is cut off.
REQUEST_WITHIN_S = 10.0
MAX_REQUESTS = 16
LOOPBACK = "127.0.0.1"
MAX_PORT = 65_535
_WHERE = re.compile(r"(?:(?P<host>\[[0-9A-Fa-f:.]+\]|[^\s:\[\]]+):)?(?P<port>[0-9]{1,5})")
WAIT_NS = 1_000_000_000


def parse_address(text: str) -> tuple[str, int]:
    """Return host and port; default host: loopback. Raises AddressError."""
    match = _WHERE.fullmatch(text)
    if match is None or int(match["port"]) > MAX_PORT:
        raise AddressError(
            f"--metrics {text}: not a port; write 9100, or ADDRESS:9100 for other machines"
        )
    return (match["host"] or LOOPBACK).strip("[]"), int(match["port"])


class MetricsHTTPServer(ThreadingMixIn, WSGIServer):
    """HTTP server that answers requests whose Host header names it, each in a thread.

    While `MAX_REQUESTS` are being served, further connections are closed.
    """

    request_queue_size = 128
    daemon_threads = True
    block_on_close = False

    def __init__(self, host: str, port: int, app: WSGIApplication) -> None:
        """Bind. Raises OSError."""
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        self.address_family, _, _, _, address = found[0]
        self._free = threading.Semaphore(MAX_REQUESTS)
        super().__init__((str(address[0]), port), _Handler)
        self.set_app(for_own_site(app, Site.at(host)))

    def server_bind(self) -> None:
        """Bind without looking up the host's name, which may wait for a name server."""
        TCPServer.server_bind(self)
        self.server_name, self.server_port = str(self.server_address[0]), self.server_address[1]
        self.setup_environ()

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Return whether another request may be served."""
        return self._free.acquire(blocking=False)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Start a thread for a request, and free its place where none can start."""
        try:
            super().process_request(request, client_address)
        except BaseException:
            self._free.release()
            raise

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a request and free its place."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Drop a connection that broke off or was too slow."""


class _Handler(WSGIRequestHandler):
    timeout = REQUEST_WITHIN_S

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: each scrape would be a line in the node's terminal."""


def for_own_site(app: WSGIApplication, site: Site) -> Callable[..., Iterable[bytes]]:
    """Return an application that answers 403 to requests for another site."""

    def guarded(environ: WSGIEnvironment, start_response: StartResponse) -> Iterable[bytes]:
        # HTTP/1.0 requests may lack a Host header; no browser sends them.
        host = environ.get("HTTP_HOST")
        refusal = host and site.refusal(host, environ.get("HTTP_ORIGIN"))
        if not refusal:
            return app(environ, start_response)
        start_response("403 Forbidden", [("Content-Type", "text/plain; charset=utf-8")])
        return [f"{refusal}\n".encode()]

    return guarded


class MetricsServer(Collector):
    """Server of metrics, which answers as soon as it is created; `follow` reads the node.

    url: address of the metrics.
    """

    def __init__(self, program: str, host: str, port: int) -> None:
        """Bind and serve. Raises AddressError."""
        self._program = program
        self._node: NodeState | None = None
        self._unreadable = 0
        registry = CollectorRegistry()
        registry.register(self)
        try:
            server = MetricsHTTPServer(host, port, make_wsgi_app(registry))
        except OSError as error:
            where = f"{in_url(host)}:{port}"
            raise AddressError(f"--metrics: cannot bind {where}: {error.strerror}") from None
        threading.Thread(target=server.serve_forever, daemon=True).start()
        self.url = f"http://{in_url(host)}:{server.server_port}/metrics"

    def collect(self) -> Iterator[Metric]:
        """Yield the metrics of now, for a request; called from any thread."""
        yield from families(self._program, self._node, time.perf_counter_ns(), self._unreadable)

    def follow(self, address: str, key: str | None) -> None:
        """Read a node's telemetry, without end."""
        keys = KeyOptions(Path(key)).telemetry_client(address) if key else None
        context: sockets.Context = zmq.Context()
        socket = sockets.connect(context, zmq.SUB, address, keys)
        for topic in (STATUS, TRACE):
            socket.subscribe(topic)
        view, age = TerminalView(), StatusAge(local=not sockets.beyond_loopback(address))
        while True:
            sockets.wait_readable([socket], WAIT_NS)
            for message in sockets.receive_multipart(socket):
                try:
                    self._take(view, age, *message)
                except (WireError, TypeError):
                    self._unreadable += 1

    def _take(self, view: TerminalView, age: StatusAge, topic: bytes, data: bytes) -> None:
        now_ns = time.perf_counter_ns()
        if topic == TRACE:
            traces = read_trace(data)
            trace = traces[0]
            view.add_trace(*traces)
            if len(trace.now_ns):
                age.take_trace(int(trace.now_ns[-1]), now_ns)
        elif topic == STATUS:
            status = read_status(data)
            age.take_status(now_ns)
            sent_ns = now_ns - (age.age_ns(now_ns) or 0)
            self._node = NodeState(status, sent_ns, view.heart_rates_per_min)
