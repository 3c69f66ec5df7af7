"""Recorder of a display's telemetry into an MCAP file."""

import logging
import math
import os
import time
from pathlib import Path

from protocol.config.quantities import count_text
from protocol.security.keys import ClientKeys
from telepulse.recording.mcap_writer import McapWriter
from telepulse.telemetry.client import TelemetryClient
from telepulse.telemetry.events import Event
from telepulse.telemetry.schema import TOPIC_NAMES

logger = logging.getLogger(__name__)

# A recorder that is killed loses what came since; half of what it may.
FLUSH_EVERY_NS = 500_000_000


class McapRecorder:
    """Recorder that runs until the display ends, falls silent or `stop` is called."""

    def __init__(
        self,
        address: str,
        path: Path,
        keys: ClientKeys | None = None,
    ) -> None:
        """Connect, and create the file. Raises AddressError or OutputError."""
        self._address, self._path = address, path
        self._stopping = False
        self._reason: str | None = None
        self._provenance: dict[str, str] | None = None
        self._client = TelemetryClient(address, keys)
        self._decoder = self._client.decoder
        try:
            self._file = McapWriter(path)
        except BaseException:
            self._client.close()
            raise

    def stop(self) -> None:
        """End the recording after the present message."""
        self._stopping = True

    def run(
        self,
        seconds: float | None = None,
        silence_s: float | None = None,
        display_pid: int | None = None,
    ) -> bool:
        """Record.

        Parameters
        ----------
        seconds : float or None
            Longest time of the recording.
        silence_s : float or None
            Time without a message that ends it.
        display_pid : int or None
            The display's process, where that started this one. Until its first message, which
            comes when its drive has found home, silence counts only once the display has ended.

        Returns
        -------
        bool
            Whether all that the display published is on the disk. A file without a message is
            removed.
        """
        self._client.subscribe()
        start_ns = received_ns = time.monotonic_ns()
        flush_ns = start_ns + FLUSH_EVERY_NS
        end_ns, silence_ns = _ns(seconds), _ns(silence_s)
        try:
            while not (self._stopping or self._decoder.ended):
                now_ns = time.monotonic_ns()
                if self._receive() or (not self._decoder.started and os.getppid() == display_pid):
                    received_ns = now_ns
                if now_ns - received_ns > silence_ns:
                    logger.warning(f"{self._path}: ended, nothing came for {silence_s:g} s")
                    break
                if now_ns - start_ns > end_ns:
                    break
                self._client.poll(now_ns)
                if now_ns >= flush_ns:
                    flush_ns = now_ns + FLUSH_EVERY_NS
                    self._report_disk(self._file.flush())
                self._client.wait(flush_ns - now_ns)
            return self._end(alone=display_pid is None)
        finally:
            self._client.close()

    def _receive(self) -> bool:
        came = False
        for entries in self._client.messages():
            came = True
            for entry in entries:
                self._file.add(entry)
            if self._decoder.provenance != self._provenance:
                self._provenance = self._decoder.provenance
                self._file.describe(self._provenance or {})
        return came

    def _report_disk(self, reason: str | None) -> None:
        """Warn once when the disk accepts nothing more, and when it does again."""
        if (reason is None) == (self._reason is None):
            return
        self._reason = reason
        if reason is None:
            level = logging.INFO
            text = f"is written again, {count_text(self._file.dropped, 'message')} lost"
        else:
            level = logging.WARNING
            text = f"cannot be written: {reason}; further messages wait in memory"
        logger.log(level, f"{self._path}: {text}")
        if self._decoder.started:
            self._file.add(self._decoder.event(Event("WARNING", "disk", text)))

    def _end(self, alone: bool) -> bool:
        reason, file, missed = self._file.close(), self._file, self._decoder.missed
        named = [
            count_text(count, *names)
            for topic, names in TOPIC_NAMES.items()
            if (count := file.written[topic])
        ]
        if self._decoder.started:
            logger.info(f"{self._path}: {', '.join(named)}")
        else:
            self._path.unlink(missing_ok=True)
            if alone:
                logger.warning(f"{self._path}: no telemetry came from {self._address}")
        if missed:
            counts = ", ".join(f"{count} {name}" for name, count in sorted(missed.items()))
            logger.warning(f"{self._path}: the recorder missed {counts}")
        if file.dropped:
            cause = reason or "memory was full while the disk was"
            logger.warning(
                f"{self._path}: {count_text(file.dropped, 'message')} could not be written: {cause}"
            )
        elif reason is not None:
            logger.warning(f"{self._path}: has no index: {reason}")
        return self._decoder.started and not (missed or file.dropped or reason)


def _ns(seconds: float | None) -> float:
    return math.inf if seconds is None else seconds * 1e9
