"""Live sensors: samples of force from serial ports, CAN buses and Lab Streaming Layer.

The sensing node reads its pulse through them, the display node its feedback film.
"""

import importlib
from typing import Any

from protocol.errors import SourceError


def library(name: str, needed_for: str) -> Any:
    """Return the module `name`. Raises SourceError with the command that installs it."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise SourceError(
            f"{needed_for} needs {name}, which cannot be loaded ({error});"
            " pip install 'telepulse[sensors]'"
        ) from None
