"""Reading of a recording into arrays."""

import math
from array import array
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from pydantic import TypeAdapter

from protocol.config.arguments import file_path
from protocol.errors import SourceError
from protocol.summary.tables import Summary
from protocol.wire.telemetry import PlaybackStatus
from telepulse.recording.reader import RecordingReader, in_tick_order
from telepulse.run import Run, RunBuilder, RunTick
from telepulse.telemetry.decoder import MARK_EVENT, Entry, Fields, PassiveReceiver
from telepulse.telemetry.schema import EVENT, STATUS, TICK

_SUMMARY = TypeAdapter(Summary)


class RecordedRun:
    """Collector of a recording's entries, in the order of `in_tick_order`, into a run."""

    def __init__(self) -> None:
        self._entries, self._builder = PassiveReceiver(), RunBuilder()
        self._playback: list[PlaybackStatus] = []
        self._summary = Summary()
        self._session: int | None = None
        self._group_delay_ns = 0
        # Of each tick: display's clock and Unix time. Of each mark: Unix time, text, tick before.
        self._now_ns, self._unix_ns = array("q"), array("q")
        self._marks: list[tuple[int, str, int]] = []

    def take(self, entry: Entry) -> None:
        """Process an entry. Raises LookupError, ValueError or TypeError for one that is not."""
        if entry.topic == TICK:
            self._now_ns.append(entry.fields["now_ns"])
            self._unix_ns.append(entry.t_ns)
            self._tick(entry.fields)
        elif entry.topic == EVENT:
            if entry.fields["name"] == MARK_EVENT:
                before = max(0, len(self._now_ns) - 1)
                self._marks.append((entry.t_ns, str(entry.fields["message"]), before))
        elif entry.topic == STATUS:
            self._status(entry.fields)
        else:
            frame, receiver = self._entries.take(entry.topic, entry.fields), self._entries.receiver
            if receiver.session != self._session and receiver.description is not None:
                self._session = receiver.session
                self._group_delay_ns = receiver.description.group_delay_ns
                self._builder.begin()
            if frame is not None:
                self._builder.add_frame(frame, self._group_delay_ns)

    def _tick(self, fields: Fields) -> None:
        entries, receiver, instant_ns = self._entries, self._entries.receiver, fields["instant_ns"]
        now_ns, states = fields["now_ns"], (fields, *fields.get("others", ()))
        ready, alive = receiver.ready, bool(fields["target_n"])
        entries.play(instant_ns)
        known = receiver.buffer.known(1, 1, 0, entries.sampled_ns(instant_ns)) if alive else None
        tick = RunTick(
            now_ns,
            receiver.clock.remote_ns(now_ns) if ready else None,
            instant_ns if ready and alive else None,
            fields["scored"],
            alive and not known,
        )
        forces = [tuple(each.get(k, math.nan) for k in ("target_n", "felt_n")) for each in states]
        self._builder.add_tick(tick, forces)

    def _status(self, fields: Fields) -> None:
        self._summary = _SUMMARY.validate_python(fields["summary"])
        if playing := fields.get("playing"):
            self._playback = [PlaybackStatus(**each) for each in playing]

    def run(self, name: str, about: dict[str, str]) -> Run:
        """Return the run; about: what a person stated about the recording."""
        run = self._builder.run(name, self._playback, self._summary)
        return replace(run, about=about, marks=sorted(self._timed_marks()))

    def _timed_marks(self) -> Iterator[tuple[float, str]]:
        """Yield the marks by the display's clock, in s since the first tick."""
        for unix_ns, text, tick in self._marks:
            if self._now_ns:
                after_ns = unix_ns - self._unix_ns[tick]
                yield (self._now_ns[tick] + after_ns - self._now_ns[0]) * 1e-9, text


def read_recording(path: Path | str) -> Run:
    """Read a recording of a display into arrays, also one that was cut short.

    What is missing is logged as a warning.

    Parameters
    ----------
    path
        The MCAP file, made by `display-node --record` or `telepulse record`.

    Returns
    -------
    Run
        The arrays have one value for each recorded tick of the display. The force at the wrist is
        the received one. `summary` is the display's last recorded one, which covers its whole run:
        also the time before the recording. `force_rmse_n` is of the arrays. `about` and `marks`
        are those of the recording.

    Raises
    ------
    ArgumentError
        If the path is none.
    SourceError
        If the file is no recording of a display, or mcap is not installed.
    """
    path = file_path("path", path)
    reader, recorded = RecordingReader(path), RecordedRun()
    try:
        for entry in in_tick_order(reader):
            recorded.take(entry)
        run = recorded.run(path.stem, reader.about)
    except (LookupError, ValueError, TypeError, ArithmeticError) as error:
        raise SourceError(f"{path}: a message is not telepulse's: {error!r:.80}") from None
    reader.log_gaps()
    if not run.contactors:
        raise SourceError(f"{path}: holds no tick of a display that played a stream")
    return run
