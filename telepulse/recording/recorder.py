"""Recorder of a display's telemetry into an MCAP file."""

import logging
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from protocol.config.quantities import count_text
from protocol.security.link_keys import ClientKeys
from protocol.wire.telemetry import RECORDER
from telepulse.recording.marks import MarkSource
from telepulse.recording.mcap_writer import McapWriter
from telepulse.telemetry.client import ALL_TOPICS, TelemetryClient
from telepulse.telemetry.decoder import MARK_EVENT
from telepulse.telemetry.events import Event
from telepulse.telemetry.schema import EVENT, TOPIC_NAMES

logger = logging.getLogger(__name__)

# A recorder that is killed loses the messages since the last flush, those of about 0.5 s.
FLUSH_EVERY_NS = 500_000_000


class TelemetryRecorder:
    """Recorder that runs until the display ends, falls silent or `stop` is called."""

    def __init__(
        self,
        address: str,
        path: Path,
        keys: ClientKeys | None = None,
        about: Mapping[str, str] = {},
        marks: Sequence[MarkSource] = (),
        name: str | None = None,
    ) -> None:
        """Connect, and create the file. Raises AddressError or OutputError.

        name: by which the display that has started this recorder knows it.
        """
        self._address, self._path = address, path
        self._about, self._marks = dict(about), marks
        self._topics = ALL_TOPICS if name is None else (*ALL_TOPICS, RECORDER + name.encode())
        self._reason: str | None = None
        self._client = TelemetryClient(address, keys)
        self._decoder = self._client.decoder
        self.stop = self._client.stop
        try:
            self._file = McapWriter(path)
        except BaseException:
            self._client.close()
            raise

    def run(
        self,
        seconds: float | None = None,
        silence_s: float | None = None,
        display_pid: int | None = None,
    ) -> bool:
        """Record, with the limits of `TelemetryClient.follow`.

        Returns
        -------
        bool
            True if everything that the display published is on the disk. A file without any
            message is removed.
        """
        provenance = None
        if self._about:
            self._file.state(self._about)
        flush_ns = time.perf_counter_ns() + FLUSH_EVERY_NS
        self._client.subscribe(self._topics)
        try:
            for entries in self._client.follow(str(self._path), seconds, silence_s, display_pid):
                for entry in entries:
                    self._file.add(entry)
                    if entry.topic == EVENT and entry.fields["name"] == MARK_EVENT:
                        logger.info(f"{self._path}: mark: {entry.fields['message']}")
                if self._decoder.provenance != provenance:
                    provenance = self._decoder.provenance
                    self._file.describe(provenance or {})
                if self._decoder.started:
                    self._request_marks()
                now_ns = time.perf_counter_ns()
                if now_ns >= flush_ns:
                    flush_ns = now_ns + FLUSH_EVERY_NS
                    self._report_disk(self._file.flush())
            return self._end(started_by_display=display_pid is not None)
        finally:
            self._client.close()

    def _request_marks(self) -> None:
        for source in self._marks:
            for mark in source.take():
                self._client.mark(*mark)

    def _report_disk(self, reason: str | None) -> None:
        """Warn once when writing fails, and once when it succeeds again."""
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

    def _end(self, started_by_display: bool) -> bool:
        reason, file, missed = self._file.close(), self._file, self._decoder.missed
        warnings = []
        if self._decoder.started:
            counts = (
                count_text(file.written[topic], *names)
                for topic, names in TOPIC_NAMES.items()
                if file.written[topic]
            )
            logger.info(f"{self._path}: {', '.join(counts)}")
        else:
            self._path.unlink(missing_ok=True)
            if not started_by_display:
                warnings.append(f"no telemetry came from {self._address}")
        if unmarked := self._client.unmarked:
            count = count_text(len(unmarked), "mark")
            warnings.append(f"{count} did not come back from the display: {', '.join(unmarked)}")
        if missed:
            counts = (f"{count} {name}" for name, count in sorted(missed.items()))
            warnings.append(f"the recorder missed {', '.join(counts)}")
        if file.dropped:
            cause = reason or "memory was full while the disk accepted nothing"
            warnings.append(f"{count_text(file.dropped, 'message')} could not be written: {cause}")
        elif reason is not None:
            warnings.append(f"has no index: {reason}")
        for warning in warnings:
            logger.warning(f"{self._path}: {warning}")
        return self._decoder.started and not (missed or unmarked or file.dropped or reason)
