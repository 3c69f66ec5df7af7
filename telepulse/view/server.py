"""Web server of the live page, with one telemetry client, in a process of its own.

Needs the extra `view` (Bokeh), which the caller has checked (`telepulse.cli.view.check_bokeh`).
"""

import errno
import logging
import math
import socket
import time
from contextlib import ExitStack
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from tornado import httputil
from tornado.httpserver import HTTPServer
from tornado.httputil import HTTPServerRequest
from tornado.ioloop import IOLoop, PeriodicCallback
from tornado.routing import Router
from tornado.web import Application, RequestHandler

from display_node.telemetry.status_age import StatusAge
from protocol.errors import AddressError
from protocol.security.budgets import TokenBucket
from protocol.security.link_keys import ClientKeys
from protocol.sockets import beyond_loopback
from telepulse.http_site import Site, in_url
from telepulse.processes import free_addresses
from telepulse.telemetry.client import TelemetryClient
from telepulse.telemetry.schema import EVENT, STATUS, TICK
from telepulse.view.live import LiveState
from telepulse.view.page import LivePage

logger = logging.getLogger(__name__)

# One thread draws for all pages. An update takes it some 10 to 20 ms, at most five times a second,
# and a new page half a second.
MAX_VIEWERS = 8
OPENED_PER_S, OPENED_AT_ONCE = 0.5, 4
# Paths that open a page; images and scripts of an open one are always served.
OPENING = ("", "/", "/autoload.js")


class AdmittingRouter(Router):
    """Router that serves the pages, or answers in one line why a request is refused.

    A request must name this server, and the number of viewers is limited. Only the first refusal
    of each kind is logged: a flood would fill the terminal.
    """

    def __init__(self, pages: BokehTornado, site: Site) -> None:
        self._pages, self._site = pages, site
        self._opened = TokenBucket(OPENED_PER_S, OPENED_AT_ONCE)
        self._warned: set[HTTPStatus] = set()
        self._refusing = Application([], log_function=lambda handler: None)

    def find_handler(
        self, request: HTTPServerRequest, **_: Any
    ) -> httputil.HTTPMessageDelegate | None:
        """Return the handler of a request; call it once for each: those that open a page count."""
        status, reason = HTTPStatus.SERVICE_UNAVAILABLE, None
        if stranger := self._site.refusal(request.host, request.headers.get("Origin")):
            status, reason = HTTPStatus.FORBIDDEN, stranger
        elif request.path in OPENING:
            if len(self._pages.get_sessions("/")) >= MAX_VIEWERS:
                reason = f"{MAX_VIEWERS} pages are open, the largest number allowed; close one"
            elif not self._opened.take(time.perf_counter_ns()):
                reason = "too many pages were opened at once; try again in a few seconds"
        if reason is None:
            return self._pages.find_handler(request)
        if status not in self._warned:
            self._warned.add(status)
            logger.warning(f"refused a request from {request.remote_ip}: {reason}")
        answer = {"status": status, "line": reason}
        return self._refusing.get_handler_delegate(request, _Refused, target_kwargs=answer)


class _Refused(RequestHandler):
    """Handler that answers a refused request in one line."""

    def initialize(self, status: HTTPStatus, line: str) -> None:
        self._status, self._line = status, line

    def prepare(self) -> None:
        self.set_status(self._status)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(self._line + "\n")


PORT = 5006
POLL_EVERY_MS = 50
# The session of a viewer that has left ends within the sum of these two times.
UNUSED_MS, CHECK_UNUSED_MS = 1_000, 1_000
# A peer that misses a ping is closed within 10 s, and 5 s for the closing handshake.
PING_EVERY_S = 5
# Time before the server closes, in which viewers receive the final state.
LINGER_S = 0.5
TRIES = 5


def bind(host: str, port: int) -> tuple[list[socket.socket], int]:
    """Listen on one port of each address of a host; return the sockets and the port.

    Raises OSError; then, unlike with tornado's function for this, no socket stays open.
    """
    bound: list[socket.socket] = []
    with ExitStack() as stack:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        for family, *_, address in sorted(set(found)):
            try:
                listening = socket.create_server((str(address[0]), port), family=family)
            except OSError as error:
                # Hosts without IPv6 may still resolve a name to an address of it.
                if bound and family == socket.AF_INET6 and error.errno != errno.EADDRINUSE:
                    continue
                raise
            bound.append(stack.enter_context(listening))
            listening.setblocking(False)
            port = listening.getsockname()[1]
        stack.pop_all()
    return bound, port


class PageServer:
    """Server of the live page of the display that publishes at `address`.

    port: None for 5006, or a free port where that is taken. Raises AddressError.
    """

    def __init__(
        self, address: str, host: str, port: int | None, keys: ClientKeys | None = None
    ) -> None:
        self._live = LiveState()
        self._began_ns = time.perf_counter_ns()
        self._local = not beyond_loopback(address)
        self._age = StatusAge(self._local)
        self._client = TelemetryClient(address, keys, ("this page", "this page"))
        self._client.subscribe()
        self._stopping = False
        self._end_ns = math.inf
        # A page that is closed while it is drawn is no reason to warn.
        logging.getLogger("bokeh.server").setLevel(logging.ERROR)
        self._loop = IOLoop.current()
        self._polling = PeriodicCallback(self._poll_telemetry, POLL_EVERY_MS)
        try:
            self._server = self._serve(host, port)
        except AddressError:
            self._client.close()
            raise
        self.url = f"http://{in_url(host)}:{self._server.port}"

    def stop(self) -> None:
        """Make `run` return soon; safe in a signal handler."""
        self._stopping = True

    def run(self, seconds: float | None = None) -> None:
        """Serve until stopped, or for `seconds`."""
        if seconds is not None:
            self._end_ns = time.perf_counter_ns() + seconds * 1e9
        try:
            self._server.start()
            self._polling.start()
            self._loop.start()
        finally:
            self._polling.stop()
            self._server.stop()
            self._server.unlisten()
            self._client.close()

    def _serve(self, host: str, port: int | None) -> BaseServer:
        free = (urlsplit(address).port or 0 for address in free_addresses(TRIES))
        numbers = [port] if port is not None else [PORT, *free]
        for number in numbers:
            try:
                listening, bound = bind(host, number)
            except OSError as error:
                reason = error.strerror
                continue
            site = Site.at(host)
            # Every request is checked by `site` before.
            origins = [f"{in_url(name)}:{bound}" for name in site.names]
            origins = ["*"] if site.any_address else origins
            pages = BokehTornado(
                {"/": self._open},
                extra_websocket_origins=origins,
                unused_session_lifetime_milliseconds=UNUSED_MS,
                check_unused_sessions_milliseconds=CHECK_UNUSED_MS,
                # A browser answers a ping even while its tab is hidden; a peer that does not read
                # is closed.
                keep_alive_milliseconds=0,
                websocket_ping_interval=PING_EVERY_S,
                websocket_ping_timeout=PING_EVERY_S,
            )
            http = HTTPServer(AdmittingRouter(pages, site))
            http.add_sockets(listening)
            return BaseServer(self._loop, pages, http)
        raise AddressError(f"cannot serve the page on {host}:{numbers[-1]}: {reason}") from None

    def _open(self, document: Document) -> None:
        LivePage(document, self._live, self._silent_ns, self._client.mark, self._local)

    def _silent_ns(self) -> int:
        """Return the age of the display's last status; before the first, the time without one."""
        now_ns = time.perf_counter_ns()
        age_ns = self._age.age_ns(now_ns)
        return now_ns - self._began_ns if age_ns is None else age_ns

    def _poll_telemetry(self) -> None:
        now_ns = time.perf_counter_ns()
        for entries in self._client.messages():
            stamps_ns = [entry.fields["now_ns"] for entry in entries if entry.topic == TICK]
            if stamps_ns:
                self._age.take_trace(stamps_ns[-1], now_ns)
            for entry in entries:
                if entry.topic == EVENT and entry.fields["name"] == "begin":
                    self._age, self._began_ns = StatusAge(self._local), now_ns
                elif entry.topic == STATUS:
                    self._age.take_status(now_ns)
                self._live.take(entry)
        self._client.poll(now_ns)
        if self._stopping or now_ns >= self._end_ns:
            self._polling.stop()
            self._loop.call_later(LINGER_S, self._loop.stop)
