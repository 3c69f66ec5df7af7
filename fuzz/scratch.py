"""A folder for the files that a target reads."""

import atexit
import shutil
import tempfile
from pathlib import Path


def scratch_folder() -> Path:
    """Make a folder that is removed with this process."""
    folder = Path(tempfile.mkdtemp(prefix="telepulse-fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
