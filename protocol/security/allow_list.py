"""The allow-list: public keys that may connect to a node, one line each as in a .pub file."""

import logging
import os
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from protocol.errors import KeyFileError
from protocol.host.output import create_file, write_whole
from protocol.refusals import LIST_UNREADABLE, REVOKED_KEY, UNKNOWN_KEY
from protocol.security.keys import READ_BY_ALL, PublicKey, is_missing, parse_public, read_lines

logger = logging.getLogger(__name__)

# Its name where no option gives another, beside the node's own key (`default_path`).
FILE_NAME = "allowed"
MAX_ALLOWED = 10_000
_MAX_BYTES = 200 * MAX_ALLOWED
POLL_EVERY_NS = 1_000_000_000
# After this time without a readable list all peers are cut off: the change may have revoked a key.
UNREADABLE_AT_MOST_NS = 10_000_000_000


class AllowList:
    """Allow-list of a running node, which is read again after each change.

    While a changed list cannot be read, no new peer may connect; after 10 s, all are cut off. The
    caller cuts the connections of the keys that `poll` returns. listed: keys on the list as it was
    read last, with their names. Raises KeyFileError if the list cannot be used at the start.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._stamp = _stamp(path)
        self.listed: Mapping[bytes, PublicKey] = self._read()
        self._once_listed = dict(self.listed)
        self._poll_ns = 0
        self._unreadable_since_ns: int | None = None
        self._reason = ""

    def cause_to_refuse(self, key: bytes) -> str | None:
        """Return the cause for which a key may not connect now; None where it may."""
        if self._unreadable_since_ns is not None:
            return LIST_UNREADABLE
        if key in self.listed:
            return None
        return REVOKED_KEY if key in self._once_listed else UNKNOWN_KEY

    def describe(self, key: bytes) -> str:
        """Return a key as the log names it: in full where no name of it is known."""
        public = self._once_listed.get(key)
        return f"key {key.hex()}" if public is None else str(public)

    def poll(self, now_ns: int) -> list[bytes]:
        """Read the list if it has changed, and return the keys that were revoked.

        These are all keys once the list has been unreadable for 10 s. Call it often: it checks the
        file once a second.
        """
        if now_ns < self._poll_ns:
            return []
        self._poll_ns = now_ns + POLL_EVERY_NS
        stamp = _stamp(self._path)
        if self._unreadable_since_ns is None and stamp == self._stamp:
            return []
        try:
            listed = self._read()
        except KeyFileError as error:
            return self._fail(str(error), now_ns)
        # The stamp is older than the reading, so a list that was written meanwhile is read again.
        self._stamp = stamp
        if self._unreadable_since_ns is not None:
            self._unreadable_since_ns, self._reason = None, ""
            logger.info(f"{self._path} is read again")
        revoked = [public for key, public in self.listed.items() if key not in listed]
        for public in revoked:
            logger.warning(f"{public} is no longer allowed")
        self.listed = listed
        self._once_listed.update(listed)
        return [public.key for public in revoked]

    def _fail(self, reason: str, now_ns: int) -> list[bytes]:
        limit_s = UNREADABLE_AT_MOST_NS // 1_000_000_000
        if self._unreadable_since_ns is None:
            self._unreadable_since_ns = now_ns
        if reason != self._reason:
            self._reason = reason
            logger.warning(
                f"{reason}; until it can be read no new peer may connect, and after {limit_s} s"
                " none may stay"
            )
        if now_ns - self._unreadable_since_ns < UNREADABLE_AT_MOST_NS or not self.listed:
            return []
        logger.warning(f"{self._path} could not be read for {limit_s} s: all peers are cut off")
        keys, self.listed = list(self.listed), {}
        return keys

    def _read(self) -> dict[bytes, PublicKey]:
        listed = read_allow_list(self._path)
        if not listed:
            logger.warning(f"{self._path} allows nobody; telepulse keys allow FILE.pub adds a key")
        return listed


def default_path(folder: Path) -> Path:
    """Return the path of the allow-list in a folder of keys."""
    return folder / FILE_NAME


def read_allow_list(path: Path) -> dict[bytes, PublicKey]:
    """Read the keys on a list and their names; none without a file.

    Empty lines and lines that begin with # are skipped. Raises KeyFileError.
    """
    return {public.key: public for _, public in _read_lines(path) if public is not None}


def allow(path: Path, public: PublicKey) -> None:
    """Add a key; a link stays one, and an existing list keeps its owner and mode.

    Raises KeyFileError, also when the key or its name is on the list already; OutputError.
    """
    with _target(path) as target:
        lines, name = _read_lines(path), public.name
        for _, known in lines:
            if known == public:
                raise KeyFileError(f"{name} is allowed already in {path}")
            if known is not None and known.name == name:
                raise KeyFileError(
                    f"{path} allows another key of the name {name}; remove that first:"
                    f" telepulse keys revoke {name}"
                )
            if known is not None and known.key == public.key:
                raise KeyFileError(f"{path} allows this key already, by the name {known.name}")
        _write_lines(target, [*(line for line, _ in lines), public.line])


def revoke(path: Path, name: str) -> None:
    """Remove the key of a name, as `allow` adds one.

    Raises KeyFileError, also when the name is not on the list; OutputError.
    """
    with _target(path) as target:
        lines = _read_lines(path)
        kept = [line for line, known in lines if known is None or known.name != name]
        if len(kept) == len(lines):
            names = ", ".join(sorted(known.name for _, known in lines if known)) or "nobody"
            raise KeyFileError(f"{path} does not allow {name}; it allows {names}")
        _write_lines(target, kept)


def _read_lines(path: Path) -> list[tuple[str, PublicKey | None]]:
    if is_missing(path):
        return []
    read, mode = read_lines(path, _MAX_BYTES, "give the file of an allow-list")
    if os.name == "posix" and mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise KeyFileError(f"{path}: others may write this allow-list; run: chmod go-w {path}")
    lines: list[tuple[str, PublicKey | None]] = []
    keys: set[bytes] = set()
    for number, line in enumerate(read, 1):
        public = None
        if line.strip() and not line.lstrip().startswith("#"):
            try:
                public = parse_public(line)
            except ValueError as error:
                raise KeyFileError(f"{path}, line {number}: {error}") from None
            if public.key in keys:
                # With two names for one key, revoking one would leave the key allowed.
                raise KeyFileError(f"{path}, line {number}: this key is on the list already")
            keys.add(public.key)
        lines.append((line, public))
    return lines


@contextmanager
def _target(path: Path) -> Iterator[Path]:
    """Yield the path that a list has without links, and keep other commands from changing it."""
    target = Path(os.path.realpath(path))
    lock = target.with_name(target.name + ".lock")
    if lock.exists():
        raise KeyFileError(
            f"{lock} exists: another command is changing the list; if none is, remove the file"
        )
    create_file(lock, "")
    try:
        yield target
    finally:
        lock.unlink()


def _write_lines(target: Path, lines: list[str]) -> None:
    text = "".join(line + "\n" for line in lines)
    if is_missing(target):
        create_file(target, text, READ_BY_ALL)
    else:
        write_whole(target, text)


def _stamp(path: Path) -> tuple[int, ...]:
    """Return a value that changes with the file or its mode; empty without access."""
    with suppress(OSError):
        status = os.stat(path)
        return status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino
    return ()
