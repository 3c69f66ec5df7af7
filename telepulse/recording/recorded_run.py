"""Reading of a recording into arrays."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from protocol.config.arguments import file_path
from protocol.errors import SourceError
from protocol.summary.fields import Summary
from telepulse.columns import join_ticks
from telepulse.recording.contents import RecordingContents, read_contents
from telepulse.recording.mcap_reader import RecordingReader, reading
from telepulse.run import Run, build_run
from telepulse.telemetry.decoder import MARK_EVENT


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
    reader = RecordingReader(path)
    contents = read_contents(reader)
    with reading(path):
        run = build_run(path.stem, contents.sessions, contents.summary or Summary())
        run = replace(run, about=reader.about, marks=sorted(_timed_marks(contents)))
    reader.log_gaps()
    if not (run.contactors and len(run.t_s)):
        raise SourceError(f"{path}: holds no tick of a display that played a stream")
    return run


def _timed_marks(contents: RecordingContents) -> Iterator[tuple[float, str]]:
    """Yield the marks by the display's clock, in s since the first tick."""
    now_ns, unix_ns = (join_ticks(contents.sessions, column) for column in ("now_ns", "unix_ns"))
    for event in contents.events:
        if event.name == MARK_EVENT and len(now_ns):
            tick = max(0, int(np.searchsorted(unix_ns, event.unix_ns, "right")) - 1)
            after_ns = event.unix_ns - unix_ns[tick]
            yield float(now_ns[tick] + after_ns - now_ns[0]) * 1e-9, event.text
