"""The HTTP server under the metrics: one short request a thread, few threads, own name alone."""

import socket
import threading
from collections.abc import Callable, Iterable
from socketserver import ThreadingMixIn
from typing import Any
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer
from wsgiref.types import StartResponse, WSGIApplication, WSGIEnvironment

from telepulse.http_site import Site

# A scrape takes some 10 ms. A peer that sends no request, or does not read, is cut off.
REQUEST_WITHIN_S = 10.0
MAX_REQUESTS = 16


class MetricsHTTPServer(ThreadingMixIn, WSGIServer):
    """Serves an application to requests that name this server.

    A request beyond `MAX_REQUESTS` at a time is closed unanswered.
    """

    request_queue_size = 128
    daemon_threads = True
    block_on_close = False

    def __init__(self, host: str, port: int, app: WSGIApplication) -> None:
        """Raises OSError where that cannot be bound."""
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        self.address_family, _, _, _, address = found[0]
        self._free = threading.Semaphore(MAX_REQUESTS)
        super().__init__((str(address[0]), port), _Handler)
        self.set_app(of_own_site(app, Site.at(host)))

    def server_bind(self) -> None:
        """Bind without looking up the host's name, which may take as long as a name server."""
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.socket.bind(self.server_address)
        self.server_address = self.socket.getsockname()
        self.server_name, self.server_port = str(self.server_address[0]), self.server_address[1]
        self.setup_environ()

    def verify_request(self, request: Any, client_address: Any) -> bool:
        """Take a place for a request; False where there is none."""
        return self._free.acquire(blocking=False)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a request and give its place back."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Drop a connection that broke off or was too slow, as the server of every scrape may."""


class _Handler(WSGIRequestHandler):
    timeout = REQUEST_WITHIN_S

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: a node's terminal is not the place for each scrape."""


def of_own_site(app: WSGIApplication, site: Site) -> Callable[..., Iterable[bytes]]:
    """Return an application that answers 403 to requests for another site."""

    def guarded(environ: WSGIEnvironment, start_response: StartResponse) -> Iterable[bytes]:
        # HTTP/1.0 asks without a name; no browser does.
        host = environ.get("HTTP_HOST")
        refusal = host and site.refusal(host, environ.get("HTTP_ORIGIN"))
        if not refusal:
            return app(environ, start_response)
        start_response("403 Forbidden", [("Content-Type", "text/plain; charset=utf-8")])
        return [f"{refusal}\n".encode()]

    return guarded
