"""The recorder beside a display: a process of its own that is there before the first tick."""

import subprocess
import sys
import time
from pathlib import Path

from display_node.node import DisplayNode
from protocol.commands import USAGE_ERROR
from protocol.errors import OutputError

STARTS_WITHIN_S = 30.0
ENDS_WITHIN_S = 10.0
LOOK_EVERY_S = 0.05
# As long as a display may be held up and still be there.
SILENT_AFTER_S = 5.0


class Recording:
    """A recorder of a display's telemetry, started; `end` once the display has ended."""

    def __init__(self, node: DisplayNode, path: Path, key: Path | None, quiet: bool) -> None:
        """key: opens the telemetry, where it is protected. Returns once the recorder listens.

        Exits as the recorder does when it cannot begin, which it has said; raises OutputError
        when it does not come.
        """
        self._path = path
        # By its name: what runs both nodes stands above them.
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-m", "telepulse.cli", "record"),
                *(node.telemetry_address, str(path), "--until-silent", str(SILENT_AFTER_S)),
                *(("--key", str(key)) if key else ("--insecure",)),
                *(("--quiet",) if quiet else ()),
            ],
            # Ctrl-C is the display's: its last word ends the recorder.
            start_new_session=True,
        )
        until_s = time.monotonic() + STARTS_WITHIN_S
        while not node.await_recorder(LOOK_EVERY_S):
            if self._process.poll() is not None:
                raise SystemExit(self._process.returncode or USAGE_ERROR)
            if time.monotonic() > until_s:
                self._process.kill()
                self._process.wait()
                raise OutputError(f"{path}: the recorder does not start")

    def end(self) -> bool:
        """Wait for the recorder to end. Returns whether all was recorded; it has said what not."""
        try:
            return self._process.wait(ENDS_WITHIN_S) == 0
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            print(f"{self._path}: the recorder did not end", file=sys.stderr)
            return False
