"""The page's shell: one socket to the display, one web server, in a process of their own.

Needs the extra `view` (Bokeh), which the caller has checked (`bokeh_is_there`).
"""

import logging
import time
from collections.abc import Callable
from urllib.parse import urlsplit

from bokeh.document import Document
from bokeh.server.server import BaseServer
from bokeh.server.tornado import BokehTornado
from bokeh.server.util import bind_sockets
from tornado.httpserver import HTTPServer
from tornado.ioloop import IOLoop, PeriodicCallback

from display_node.telemetry.age import TelemetryAge
from protocol.errors import AddressError
from protocol.security.keys import ClientKeys
from protocol.sockets import beyond_loopback
from telepulse.http_site import Site
from telepulse.processes import free_addresses
from telepulse.telemetry.client import TelemetryReader
from telepulse.telemetry.schema import EVENT, STATUS, TICK
from telepulse.telemetry.transcript import Entry
from telepulse.view.admission import Admission, AdmittingRouter
from telepulse.view.live import LiveState
from telepulse.view.page import Viewer

PORT = 5006
LISTEN_EVERY_MS = 50
# A viewer that has left is forgotten within the sum of both.
UNUSED_MS, LOOK_FOR_UNUSED_MS = 1_000, 1_000
# Who has not answered one ping by the next is gone: within 10 s, and 5 s for a last word.
PING_EVERY_S = 5
# So that those who watch see how it ended.
LAST_LOOK_S = 0.5
TRIES = 5


class PageServer:
    """Serves the live page of the display that publishes at `address`.

    host, port: where; None: 5006, or a free port when that is taken. warn: is told why the display
    cannot be heard. Raises AddressError.
    """

    def __init__(
        self,
        address: str,
        host: str,
        port: int | None,
        warn: Callable[[str], None],
        keys: ClientKeys | None = None,
    ) -> None:
        self._warn = warn
        self._live = LiveState()
        self._began_ns = time.monotonic_ns()
        self._local = not beyond_loopback(address)
        self._age = TelemetryAge(self._local)
        self._reader = TelemetryReader(address, keys, warn)
        self._reader.listen()
        self._stopping = False
        self._end_ns: int | None = None
        # Whoever closes the page while it is drawn is no reason to warn.
        logging.getLogger("bokeh.server").setLevel(logging.ERROR)
        self._loop = IOLoop.current()
        self._listening = PeriodicCallback(self._listen, LISTEN_EVERY_MS)
        self._server = self._serve(host, port)
        self.url = f"http://{_in_url(host)}:{self._server.port}"

    @property
    def viewers(self) -> int:
        """Number of open pages."""
        return len(self._server.get_sessions())

    def stop(self) -> None:
        """End soon; good to call from a signal's handler."""
        self._stopping = True

    def run(self, seconds: float | None = None) -> None:
        """Serve until stopped, or for so long."""
        self._end_ns = None if seconds is None else time.monotonic_ns() + round(seconds * 1e9)
        try:
            self._server.start()
            self._listening.start()
            self._loop.start()
        finally:
            self._listening.stop()
            self._server.stop()
            self._server.unlisten()
            self._reader.close()

    def _serve(self, host: str, port: int | None) -> BaseServer:
        free = (urlsplit(address).port or 0 for address in free_addresses(TRIES))
        numbers = [port] if port is not None else [PORT, *free]
        for number in numbers:
            try:
                listening, bound = bind_sockets(host, number)
            except OSError as error:
                reason = error.strerror
                continue
            site = Site.at(host)
            pages = BokehTornado(
                {"/": self._open},
                extra_websocket_origins=[f"{_in_url(name)}:{bound}" for name in site.names],
                unused_session_lifetime_milliseconds=UNUSED_MS,
                check_unused_sessions_milliseconds=LOOK_FOR_UNUSED_MS,
                # A browser answers a ping even while its tab is hidden; a peer that does not read
                # is closed.
                keep_alive_milliseconds=0,
                websocket_ping_interval=PING_EVERY_S,
                websocket_ping_timeout=PING_EVERY_S,
            )
            admission = Admission(site, lambda: self.viewers, self._warn)
            http = HTTPServer(AdmittingRouter(pages, admission))
            http.add_sockets(listening)
            return BaseServer(self._loop, pages, http)
        raise AddressError(f"cannot serve the page on {host}:{numbers[-1]}: {reason}") from None

    def _open(self, document: Document) -> None:
        """Somebody opens the page."""
        Viewer(document, self._live, self._silent_ns)

    def _silent_ns(self) -> int:
        """Return the age of the display's last status; before it, how long there was none."""
        now_ns = time.monotonic_ns()
        age_ns = self._age.age_ns(now_ns)
        return now_ns - self._began_ns if age_ns is None else age_ns

    def _listen(self) -> None:
        now_ns = time.monotonic_ns()
        for entries in self._reader.messages():
            self._take(entries, now_ns)
        self._reader.tend(now_ns)
        over = self._end_ns is not None and now_ns >= self._end_ns
        if self._stopping or over:
            self._listening.stop()
            self._loop.call_later(LAST_LOOK_S, self._loop.stop)

    def _take(self, entries: list[Entry], received_ns: int) -> None:
        """Take the entries of one message."""
        stamps_ns = [entry.fields["now_ns"] for entry in entries if entry.topic == TICK]
        if stamps_ns:
            self._age.take_trace(stamps_ns[-1], received_ns)
        for entry in entries:
            if entry.topic == EVENT and entry.fields["name"] == "begin":
                self._age, self._began_ns = TelemetryAge(self._local), received_ns
            elif entry.topic == STATUS:
                self._age.take_status(received_ns)
            self._live.take(entry)


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host
