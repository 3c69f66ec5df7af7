"""The allow-list: the public keys that a node lets in, a line each, as they stand in .pub files."""

import os
import stat
from pathlib import Path

from protocol.errors import KeyFileError
from protocol.keys import READ_BY_ALL, PublicKey, create, parse_public, read_text

MAX_ALLOWED = 10_000
_MAX_BYTES = 200 * MAX_ALLOWED


def read_allowed(path: Path) -> dict[bytes, PublicKey]:
    """Who is allowed, by key; nobody where there is no file. Raises KeyFileError.

    Empty lines and lines that begin with # say nothing.
    """
    return {public.key: public for _, public in _read(path) if public is not None}


def allow(path: Path, public: PublicKey) -> None:
    """Add a key. Raises KeyFileError, also where its name or itself is there already."""
    lines = _read(path)
    for known in (known for _, known in lines if known is not None):
        if known == public:
            raise KeyFileError(f"{public.name} is allowed already in {path}")
        if known.name == public.name:
            raise KeyFileError(
                f"{path} allows another key of the name {public.name}; take that out first:"
                f" telepulse keys revoke {public.name}"
            )
        if known.key == public.key:
            raise KeyFileError(f"{path} allows this key already, by the name {known.name}")
    _replace(path, [*(line for line, _ in lines), public.line])


def revoke(path: Path, name: str) -> None:
    """Take out the key of a name. Raises KeyFileError where there is none."""
    lines = _read(path)
    kept = [line for line, known in lines if known is None or known.name != name]
    if len(kept) == len(lines):
        names = ", ".join(sorted(known.name for _, known in lines if known)) or "nobody"
        raise KeyFileError(f"{path} does not allow {name}; it allows {names}")
    _replace(path, kept)


def _read(path: Path) -> list[tuple[str, PublicKey | None]]:
    try:
        if not path.exists():
            return []
    except OSError as error:
        raise KeyFileError(f"{path}: cannot read: {error.strerror}") from None
    text, mode = read_text(path, _MAX_BYTES)
    if os.name == "posix" and mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise KeyFileError(f"{path}: others may write this allow-list; run: chmod go-w {path}")
    lines: list[tuple[str, PublicKey | None]] = []
    keys: set[bytes] = set()
    for number, line in enumerate(text.splitlines(), 1):
        public = None
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                public = parse_public(line)
            except ValueError as error:
                raise KeyFileError(f"{path}, line {number}: {error}") from None
            if public.key in keys:
                # Else revoking one of its names would leave the key allowed.
                raise KeyFileError(f"{path}, line {number}: this key stands there already")
            keys.add(public.key)
        lines.append((line, public))
    return lines


def _replace(path: Path, lines: list[str]) -> None:
    """Write the list anew: a node that reads it meets the old one or the new one, whole."""
    new = path.with_name(path.name + ".new")
    if new.exists():
        raise KeyFileError(
            f"{new} is there: another command changes the list; if none does, remove it"
        )
    create(new, "".join(line + "\n" for line in lines), READ_BY_ALL)
    try:
        os.replace(new, path)
    except OSError as error:
        new.unlink()
        raise KeyFileError(f"{path}: cannot write: {error.strerror}") from None
