"""Bounds of what is read: regular files, and as many samples as a long recording has.

A file states how much it holds before any of it is read. A statement beyond a bound is refused
before memory is allocated for it.
"""

import stat
from pathlib import Path

from protocol.errors import SourceError

# Most samples of a signal: 48 h at 1 kHz.
MOST_HOURS, MOST_HOURS_AT_HZ = 48, 1_000
MOST_SAMPLES = MOST_HOURS * 3_600 * MOST_HOURS_AT_HZ
# Most bytes that are read as a whole or unpacked: these samples in 64 bits.
MOST_BYTES = 8 * MOST_SAMPLES
_KINDS = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a character device"),
    (stat.S_ISBLK, "a block device"),
    (stat.S_ISSOCK, "a socket"),
)


def check_regular(path: Path) -> None:
    """Refuse what exists and is neither a regular file nor a folder. Raises SourceError."""
    if path.exists():
        mode = path.stat().st_mode
        for is_kind, kind in _KINDS:
            if is_kind(mode):
                raise SourceError(f"{path}: is {kind}; copy what it gives into a regular file")


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
    check_bytes(path, path.stat().st_size)
    return path.read_bytes()
