"""The recorder beside a display: a process of its own that is there before the drive moves."""

import logging
import os
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from protocol.cli_options import USAGE_ERROR
from protocol.errors import OutputError
from protocol.host.child_process import ChildProcess, sidecar_module

logger = logging.getLogger(__name__)

STARTS_WITHIN_S = 30.0
ENDS_WITHIN_S = 10.0
LOOK_EVERY_S = 0.05
# As long as a display may be held up and still be there.
SILENT_AFTER_S = 5.0


class RecorderProcess:
    """The outcome of a recording: whole, unless the recorder named what is missing."""

    whole = True


@contextmanager
def start_recorder(
    address: str,
    await_recorder: Callable[[float], bool],
    path: Path | None,
    key: Path | None,
    log_options: Sequence[str],
) -> Iterator[RecorderProcess]:
    """Record a display's telemetry to `path` (None: not at all) within a `with`.

    The recorder listens when the `with` begins, so that its first tick is recorded; the outcome
    is known when the `with` has ended. A display that fails before its first tick leaves no file.

    address: of the telemetry. await_recorder: waits so many seconds until a recorder listens, and
    returns whether one does. key: opens the telemetry, where it is protected.
    log_options: the recorder's, of its log.

    Raises SystemExit with the recorder's status where it refuses to begin, OutputError where it
    does not listen in time, and SidecarError where no recorder is installed.
    """
    recording = RecorderProcess()
    if path is None:
        yield recording
        return
    process = _start(address, await_recorder, path, key, log_options)
    try:
        yield recording
    except BaseException:
        process.terminate()
        _end(process, path)
        raise
    recording.whole = _end(process, path)


def _start(
    address: str,
    await_recorder: Callable[[float], bool],
    path: Path,
    key: Path | None,
    log_options: Sequence[str],
) -> ChildProcess:
    """Start the recorder and wait until it listens."""
    process = ChildProcess(
        *("recorder", "-m", sidecar_module("recorder"), address, str(path)),
        *("--until-silent", str(SILENT_AFTER_S)),
        *("--display-pid", str(os.getpid())),
        *(("--key", str(key)) if key else ("--insecure",)),
        *log_options,
    )
    until_s = time.monotonic() + STARTS_WITHIN_S
    while not await_recorder(LOOK_EVERY_S):
        if process.poll() is not None:
            raise SystemExit(process.returncode or USAGE_ERROR)
        if time.monotonic() > until_s:
            process.kill()
            process.wait()
            raise OutputError(f"{path}: the recorder does not start")
    return process


def _end(process: ChildProcess, path: Path) -> bool:
    """Wait for the recorder to end. Return whether it recorded all; it prints what it missed."""
    try:
        return process.wait(ENDS_WITHIN_S) == 0
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        logger.warning(f"{path}: the recorder did not end")
        return False
