"""Input files: regular files within a bound, and text whose depth is known before it is parsed.

A pipe would block its reader and a device never ends. A parser takes time and stack by the depth of
a text, which is cheap to find.
"""

import errno
import re
import stat
from pathlib import Path
from typing import BinaryIO

_KINDS = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a character device"),
    (stat.S_ISBLK, "a block device"),
    (stat.S_ISSOCK, "a socket"),
)
# A scene has 6 levels, a summary 5.
DEEPEST = 32
# Strings and comments of TOML and JSON, and the marks of depth: brackets, and the dots of a key.
_MARKS = re.compile(
    r'"""(?:\\.|[^\\])*?(?:"{3,5}|\Z)|'
    r"'''.*?(?:'{3,5}|\Z)|"
    r'"(?:\\.|[^"\\\n])*+"?|'
    r"'[^'\n]*+'?|#[^\n]*+|[][{}.,=\n]",
    re.DOTALL,
)


def open_regular(path: Path, most_bytes: int | None = None) -> BinaryIO:
    """Open a regular file of at most `most_bytes` for reading; None: of any size.

    Raises OSError, whose reason fits behind "cannot be read".
    """
    try:
        found = path.stat()
    except ValueError as error:  # a null character in the name
        raise OSError(errno.EINVAL, str(error), str(path)) from None
    for is_kind, kind in _KINDS:
        if is_kind(found.st_mode):
            reason = f"it is {kind}; copy what it gives into a regular file"
            raise OSError(errno.EINVAL, reason, str(path))
    if most_bytes is not None and found.st_size > most_bytes:
        reason = f"it has {found.st_size} bytes; at most {most_bytes} are read"
        raise OSError(errno.EFBIG, reason, str(path))
    return path.open("rb")


def read_regular(path: Path, most_bytes: int) -> bytes:
    """Return the bytes of a regular file. Raises OSError as `open_regular` does."""
    with open_regular(path, most_bytes) as file:
        # Not more, where it grows meanwhile.
        return file.read(most_bytes)


def shallow(text: str) -> str:
    """Return a text in TOML or JSON. Raises ValueError where it is nested deeper than `DEEPEST`.

    Tables, lists and the parts of a key count.
    """
    brackets = dots = 0
    for mark in _MARKS.findall(text):
        if mark in "[{":
            brackets += 1
        elif mark in "]}":
            brackets -= 1
        if mark == ".":
            dots += 1
        elif mark[0] not in "\"'":
            dots = 0
        if max(brackets, dots) > DEEPEST:
            raise ValueError(f"nested deeper than {DEEPEST}")
    return text
