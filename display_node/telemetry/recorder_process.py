"""The recorder of a display: a process of its own that runs before the drive moves."""

import logging
import os
import secrets
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from display_node.telemetry.publisher import Publisher
from protocol.cli_options import USAGE_ERROR
from protocol.errors import OutputError
from protocol.faults import Part
from protocol.host.child_process import ChildProcess, sidecar_module
from protocol.summary.fields import Summary

logger = logging.getLogger(__name__)

STARTS_WITHIN_S = 30.0
ENDS_WITHIN_S = 10.0
LOOK_EVERY_S = 0.05
# Silence after which the recorder takes the display for ended; a shorter one may be a stall.
SILENT_AFTER_S = 5.0


@contextmanager
def start_recorder(
    publisher: Publisher,
    path: Path | None,
    key: Path | None,
    options: Sequence[str],
) -> Iterator[ChildProcess | None]:
    """Record a display's telemetry to `path` within a `with`; None records nothing.

    The recorder has subscribed when the `with` begins, so the first tick is recorded. It has a
    random name, so that no other reader is taken for it. It has ended with the `with`, with status
    0 where it has all that was published until its end; one that ends before the display is a note
    of the `publisher`. A display that fails before its first tick leaves no file.

    options: of `telepulse record`. Raises SystemExit, OutputError or SidecarError where the
    recorder refuses to begin, does not subscribe in time, or is not installed.
    """
    if path is None:
        yield None
        return
    name = secrets.token_hex(8)
    with ChildProcess(
        *("recorder", "-m", sidecar_module("recorder"), publisher.address, str(path)),
        *("--recorder-name", name),
        *("--until-silent", str(SILENT_AFTER_S), "--display-pid", str(os.getpid())),
        *(("--key", str(key)) if key else ("--insecure",)),
        *options,
    ) as process:
        until_s = time.monotonic() + STARTS_WITHIN_S
        while not publisher.await_recorder(LOOK_EVERY_S, name):
            if process.poll() is not None:
                raise SystemExit(process.returncode or USAGE_ERROR)
            if time.monotonic() > until_s:
                raise OutputError(f"{path}: the recorder does not start")
        try:
            yield process
        except BaseException:
            process.terminate()
            raise
        finally:
            # The recorder itself prints what is missing.
            try:
                process.wait(ENDS_WITHIN_S)
            except subprocess.TimeoutExpired:
                logger.warning(f"{path}: the recorder did not end")


def is_whole(recorder: ChildProcess | None, summary: Summary) -> bool:
    """Return whether a run is recorded from beginning to end, or was not to be recorded.

    recorder: as `start_recorder` yields it, after the end. summary: of the run. One that was asked
    to end early has the status 0.
    """
    if recorder is None:
        return True
    gone = any(note.part is Part.RECORDER for note in summary.notes)
    return recorder.returncode == 0 and not gone
