"""Outlet of a display's telemetry to LSL."""

import logging
import math
import time

from protocol.config.quantities import count_text
from protocol.security.keys import ClientKeys
from telepulse.lsl_outlet.forwarder import LslForwarder
from telepulse.lsl_outlet.streams import LslStreams
from telepulse.telemetry.client import TelemetryClient

logger = logging.getLogger(__name__)

POLL_EVERY_NS = 100_000_000


class LslOutlet:
    """Outlet that runs until the display ends, falls silent or `stop` is called."""

    def __init__(
        self,
        address: str,
        keys: ClientKeys | None = None,
    ) -> None:
        """Connect. Raises SourceError without LSL, or AddressError."""
        self._address = address
        self._stopping = False
        self._outlets = LslStreams(address)
        self._forwarder = LslForwarder(self._outlets)
        self._client = TelemetryClient(address, keys)
        self._client.subscribe()

    def stop(self) -> None:
        """End after the present message."""
        self._stopping = True

    def run(self, seconds: float | None = None, silence_s: float | None = None) -> bool:
        """Forward until the end; return whether all that the display published arrived.

        Parameters
        ----------
        seconds : float or None
            Longest time.
        silence_s : float or None
            Time without a message that ends it.
        """
        start_ns = received_ns = now_ns = time.monotonic_ns()
        end_ns = start_ns + (math.inf if seconds is None else seconds * 1e9)
        silence_ns = math.inf if silence_s is None else silence_s * 1e9
        client = self._client
        try:
            while not (self._stopping or client.decoder.ended) and now_ns < end_ns:
                now_ns = time.monotonic_ns()
                for entries in client.messages():
                    received_ns = now_ns
                    self._forwarder.take(entries)
                if now_ns - received_ns > silence_ns:
                    logger.warning(f"{self._address}: ended, nothing came for {silence_s:g} s")
                    break
                client.poll(now_ns)
                client.wait(POLL_EVERY_NS)
            return self._end()
        finally:
            self._outlets.close()
            client.close()

    def _end(self) -> bool:
        self._forwarder.finish()
        passed, decoder = self._forwarder.passed, self._client.decoder
        if not decoder.started:
            logger.warning(f"{self._address}: no telemetry came from it")
            return False
        given = ", ".join(
            count_text(passed[f"{name}s"], name) for name in ("sample", "tick", "event")
        )
        early = passed["frames too early"]
        before = (
            f"; {count_text(early, 'frame')} came before the sensing clock was known"
            if early
            else ""
        )
        logger.info(
            f"{self._address}: {given};"
            f" {count_text(self._forwarder.lost, 'sample')} missing{before}"
        )
        if decoder.missed:
            counts = ", ".join(f"{n} {name}" for name, n in sorted(decoder.missed.items()))
            logger.warning(f"{self._address}: of the telemetry {counts} were missed")
        return not decoder.missed
