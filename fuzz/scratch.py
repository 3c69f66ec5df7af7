"""A folder for the files that a target has read."""

import atexit
import shutil
import tempfile
from pathlib import Path


def scratch_folder() -> Path:
    """A new one, gone with this process; the fuzzer ends otherwise, and its runner clears up."""
    folder = Path(tempfile.mkdtemp(prefix="telepulse-fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
