"""Bounds of what is read: regular files, and as many samples as a long recording has.

A file states how much it holds before any of it is read. A statement beyond a bound is refused
before memory is allocated for it.
"""

import json
import os
from pathlib import Path
from typing import Any

from protocol.errors import SourceError
from protocol.input_files import DEEPEST, open_regular, shallow

# Most samples of a signal: 48 h at 1 kHz.
MOST_HOURS, MOST_HOURS_AT_HZ = 48, 1_000
MOST_SAMPLES = MOST_HOURS * 3_600 * MOST_HOURS_AT_HZ
# Most bytes that are read as a whole or unpacked: these samples in 64 bits.
MOST_BYTES = 8 * MOST_SAMPLES
# Longest message in JSON: a frame or a status of telepulse has at most half of it.
MOST_JSON_BYTES = 1 << 21


def check_regular(path: Path) -> None:
    """Refuse what exists and is neither a regular file nor a folder. Raises SourceError."""
    try:
        if not path.is_dir():
            open_regular(path).close()
    except FileNotFoundError:
        return
    except OSError as error:
        raise SourceError(f"{path}: cannot be read: {error.strerror}") from None


def check_samples(path: Path, samples: int) -> None:
    """Refuse a number of samples of one signal beyond the bound. Raises SourceError."""
    if samples > MOST_SAMPLES:
        raise SourceError(
            f"{path}: states {samples} samples; at most {MOST_SAMPLES} are read"
            f" ({MOST_HOURS} h at {MOST_HOURS_AT_HZ} Hz): cut it into parts"
        )


def check_bytes(path: Path, size: int, what: str = "has") -> None:
    """Refuse a number of bytes beyond the bound. Raises SourceError."""
    if size > MOST_BYTES:
        raise SourceError(
            f"{path}: {what} {size * 1e-9:.3g} GB; at most {MOST_BYTES * 1e-9:.3g} GB are read"
            f" ({MOST_HOURS} h at {MOST_HOURS_AT_HZ} Hz): cut it into parts"
        )


def read_whole(path: Path) -> bytes:
    """Return the bytes of a regular file. Raises SourceError or OSError."""
    check_regular(path)
    with open_regular(path) as file:
        check_bytes(path, os.fstat(file.fileno()).st_size)
        return file.read()


def read_json(data: bytes) -> Any:
    """Return the value of a message in JSON. Raises ValueError, also for one beyond the bounds."""
    if len(data) > MOST_JSON_BYTES:
        raise ValueError(f"{len(data)} bytes long, at most {MOST_JSON_BYTES} are read")
    # Most messages have a bracket or two, and pass without the search for the deepest.
    if data.count(b"[") + data.count(b"{") > DEEPEST:
        shallow(data.decode())
    return json.loads(data)
