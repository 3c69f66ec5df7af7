"""Admission to the page: requests under this server's own name, and few enough to draw for all."""

import time
from collections.abc import Callable
from http import HTTPStatus
from typing import Any

from tornado import httputil
from tornado.httputil import HTTPServerRequest
from tornado.routing import Router
from tornado.web import Application, RequestHandler

from protocol.security.budgets import TokenBucket
from telepulse.http_site import Site

# One thread draws for all: a picture takes it some 10 to 20 ms, five times a second at most, and a
# new page half a second.
MAX_VIEWERS = 8
OPENED_PER_S, OPENED_AT_ONCE = 0.5, 4
# What opens a page; images and scripts of one that is open are always served.
OPENING = ("", "/", "/autoload.js")


class Admission:
    """Decides of each request whether it is served.

    viewers: counts the pages that are open. warn: is given a reason, once for each kind.
    """

    def __init__(self, site: Site, viewers: Callable[[], int], warn: Callable[[str], None]) -> None:
        self._site, self._viewers, self._warn = site, viewers, warn
        self._opened = TokenBucket(OPENED_PER_S, OPENED_AT_ONCE)
        self._warned: set[HTTPStatus] = set()

    def refusal(self, request: HTTPServerRequest) -> tuple[HTTPStatus, str] | None:
        """Return the status and the one line that refuse a request; None where it is served.

        Call it once for each request: those that open a page are counted.
        """
        refusal = self._judge(request)
        if refusal is not None and refusal[0] not in self._warned:
            self._warned.add(refusal[0])
            self._warn(f"refused a request from {request.remote_ip}: {refusal[1]}")
        return refusal

    def _judge(self, request: HTTPServerRequest) -> tuple[HTTPStatus, str] | None:
        reason = self._site.refusal(request.host, request.headers.get("Origin"))
        if reason is not None:
            return HTTPStatus.FORBIDDEN, reason
        if request.path not in OPENING:
            return None
        if self._viewers() >= MAX_VIEWERS:
            reason = f"{MAX_VIEWERS} pages are open already, which is the most; close one"
            return HTTPStatus.SERVICE_UNAVAILABLE, reason
        if not self._opened.take(time.monotonic_ns()):
            reason = "too many pages were opened at once; try again in a few seconds"
            return HTTPStatus.SERVICE_UNAVAILABLE, reason
        return None


class AdmittingRouter(Router):
    """Answers what is refused, and passes everything else on to the pages' own routes."""

    def __init__(self, pages: Application, admission: Admission) -> None:
        self._pages, self._admission = pages, admission
        # Refusals are not logged one by one: a flood would fill the terminal.
        self._refusing = Application([], log_function=lambda handler: None)

    def find_handler(
        self, request: HTTPServerRequest, **_: Any
    ) -> httputil.HTTPMessageDelegate | None:
        """Return what handles a request."""
        refusal = self._admission.refusal(request)
        if refusal is None:
            return self._pages.find_handler(request)
        arguments = {"refusal": refusal}
        return self._refusing.get_handler_delegate(request, _Refused, target_kwargs=arguments)


class _Refused(RequestHandler):
    """Answers a refused request in one line."""

    def initialize(self, refusal: tuple[HTTPStatus, str]) -> None:
        self._code, self._line = refusal

    def prepare(self) -> None:
        self.set_status(self._code)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(self._line + "\n")
