"""The recorder's shell: a display's telemetry, one file, and the clock on the wall."""

import math
import os
import time
from collections.abc import Callable
from pathlib import Path

from protocol.config.quantities import count_text
from protocol.security.keys import ClientKeys
from telepulse.recording.mcap_writer import McapWriter
from telepulse.telemetry.client import TelemetryReader
from telepulse.telemetry.events import Event
from telepulse.telemetry.schema import NAMES

# A recorder that is killed loses what came since; half of what it may.
FLUSH_EVERY_NS = 500_000_000


class McapRecorder:
    """Writes what a display publishes, until that ends, falls silent or `stop` is called."""

    def __init__(
        self,
        address: str,
        path: Path,
        log: Callable[[str], None],
        warn: Callable[[str], None],
        keys: ClientKeys | None = None,
    ) -> None:
        """log is told how it goes, warn of what is missing. Raises AddressError or OutputError."""
        self._address, self._path = address, path
        self._log, self._warn = log, warn
        self._stopping = False
        self._reason: str | None = None
        self._provenance: dict[str, str] | None = None
        self._reader = TelemetryReader(address, keys, warn)
        self._transcript = self._reader.transcript
        try:
            self._file = McapWriter(path)
        except BaseException:
            self._reader.close()
            raise

    def stop(self) -> None:
        """End after the present message."""
        self._stopping = True

    def run(
        self,
        seconds: float | None = None,
        silence_s: float | None = None,
        display_pid: int | None = None,
    ) -> bool:
        """Record; seconds: for so long at most. silence_s: until nothing came for so long.

        display_pid: of the display, where that has started this process. Until its first message,
        which comes when its drive has found home, silence counts only once it has ended.

        Returns whether all that the display published is on the disk. A file without a message
        is removed.
        """
        self._reader.listen()
        start_ns = heard_ns = time.monotonic_ns()
        flush_ns = start_ns + FLUSH_EVERY_NS
        end_ns, patience_ns = _ns(seconds), _ns(silence_s)
        try:
            while not (self._stopping or self._transcript.ended):
                now_ns = time.monotonic_ns()
                if self._receive() or (not self._transcript.known and os.getppid() == display_pid):
                    heard_ns = now_ns
                if now_ns - heard_ns > patience_ns:
                    self._warn(f"{self._path}: ended, nothing came for {silence_s:g} s")
                    break
                if now_ns - start_ns > end_ns:
                    break
                self._reader.tend(now_ns)
                if now_ns >= flush_ns:
                    flush_ns = now_ns + FLUSH_EVERY_NS
                    self._notice(self._file.flush())
                self._reader.wait(flush_ns - now_ns)
            return self._end(alone=display_pid is None)
        finally:
            self._reader.close()

    def _receive(self) -> bool:
        came = False
        for entries in self._reader.messages():
            came = True
            for entry in entries:
                self._file.add(entry)
            if self._transcript.provenance != self._provenance:
                self._provenance = self._transcript.provenance
                self._file.describe(self._provenance or {})
        return came

    def _notice(self, reason: str | None) -> None:
        """Say once when the disk takes nothing more, and when it does again."""
        if (reason is None) == (self._reason is None):
            return
        self._reason = reason
        if reason is None:
            text = f"is written again, {count_text(self._file.dropped, 'message')} lost"
        else:
            text = f"cannot be written: {reason}; what comes waits in memory"
        self._warn(f"{self._path}: {text}")
        if self._transcript.known:
            self._file.add(self._transcript.event(Event("WARNING", "disk", text)))

    def _end(self, alone: bool) -> bool:
        reason, file, missed = self._file.close(), self._file, self._transcript.missed
        named = [
            count_text(file.written[t], *names) for t, names in NAMES.items() if file.written[t]
        ]
        if self._transcript.known:
            self._log(f"{self._path}: {', '.join(named)}")
        else:
            self._path.unlink(missing_ok=True)
            if alone:
                self._warn(f"{self._path}: nothing was heard from {self._address}")
        if missed:
            counts = ", ".join(f"{count} {name}" for name, count in sorted(missed.items()))
            self._warn(f"{self._path}: the recorder missed {counts}")
        if file.dropped:
            cause = reason or "memory was full while the disk was"
            self._warn(
                f"{self._path}: {count_text(file.dropped, 'message')} could not be written: {cause}"
            )
        elif reason is not None:
            self._warn(f"{self._path}: has no index: {reason}")
        return self._transcript.known and not (missed or file.dropped or reason)


def _ns(seconds: float | None) -> float:
    return math.inf if seconds is None else seconds * 1e9
