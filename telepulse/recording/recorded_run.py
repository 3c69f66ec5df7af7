"""Reading of a recording into arrays."""

from pathlib import Path

from protocol.config.arguments import file_path
from protocol.errors import SourceError
from protocol.summary.fields import Summary
from telepulse.recording.contents import read_contents
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
        The arrays have one row for each tick of the display, of NaN where a tick is missing. Of
        ticks that are more than a minute apart, they have the longest part; the rest is logged as
        a warning. The force at the wrist is the received one. `summary` is the display's last
        recorded one, which covers its whole run: also the time before the recording.
        `force_rmse_n` is of the arrays. `about` and `marks` are those of the recording.

    Raises
    ------
    ArgumentError
        If the path is none.
    SourceError
        If the file is no recording of a display, its ticks are too few for equal steps, or mcap is
        not installed.
    """
    path = file_path("path", path)
    reader = RecordingReader(path)
    contents = read_contents(reader)
    marks = [(each.unix_ns, each.text) for each in contents.events if each.name == MARK_EVENT]
    with reading(path):
        run = build_run(path, contents.sessions, contents.summary or Summary(), reader.about, marks)
    reader.log_gaps()
    if not (run.contactors and len(run.t_s)):
        raise SourceError(f"{path}: holds no tick of a display that played a stream")
    return run
