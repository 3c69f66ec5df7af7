"""The targets, one file each.

A target has `seeds()`, small inputs to begin with, most of them valid, and `try_one(data)`, which
raises when a property does not hold. `MSGPACK = True`: its inputs are mutated as msgpack.
"""

import atexit
import pkgutil
import shutil
import tempfile
from pathlib import Path

NAMES = tuple(sorted(module.name for module in pkgutil.iter_modules(__path__)))


def scratch_folder() -> Path:
    """Make a folder that is removed with this process."""
    folder = Path(tempfile.mkdtemp(prefix="telepulse-fuzz-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
