"""Key files: the identity of a node, and of its peers.

A secret key is a file of one line that only its owner may read. Its public key is a file of one
line that may be sent to anybody. The keys are those of CurveZMQ (RFC 26): 32 bytes each, the public
one computed from the secret one. The key files of `zmq.auth` have no name, no mode and no check
that the halves match (docs/decisions/0031-zmq-auth-is-not-enough.md).
"""

import os
import re
import stat
from dataclasses import dataclass, field
from pathlib import Path

import zmq
from zmq.utils import z85

from protocol.errors import KeyFileError, OutputError
from protocol.host.output import create_file
from protocol.input_files import open_regular

SECRET, PUBLIC = "telepulse-secret-key", "telepulse-public-key"
SECRET_ENDING, PUBLIC_ENDING = ".key", ".pub"
KEY_BYTES = 32
# Hexadecimal digits of a key that the log gives beside its name.
NAMED_DIGITS = 16
OWNER_ONLY, READ_BY_ALL, FOLDER = 0o600, 0o644, 0o700
# Longest file that is read; a key's line is far shorter.
MAX_KEY_FILE_BYTES = 4096
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_HEX = re.compile(r"[0-9A-Fa-f]{64}")


@dataclass(frozen=True, slots=True)
class PublicKey:
    """Public key of 32 bytes, with the name of its owner."""

    name: str
    key: bytes

    def __str__(self) -> str:
        """Return the name and the beginning of the key, as the log names a peer."""
        return f"{self.name} (key {self.key.hex()[:NAMED_DIGITS]}...)"

    @property
    def file_name(self) -> str:
        """Name of the file in which it was made."""
        return self.name + PUBLIC_ENDING

    @property
    def line(self) -> str:
        """The key as a line of a file, without the line's end."""
        return f"{PUBLIC} {self.name} {self.key.hex()}"


@dataclass(frozen=True, slots=True)
class KeyPair:
    """Key pair of a node; `secret` (32 bytes) proves its identity."""

    name: str
    secret: bytes = field(repr=False)

    @property
    def public(self) -> PublicKey:
        """Public half of the pair."""
        return PublicKey(self.name, z85.decode(zmq.curve_public(z85.encode(self.secret))))


def new_pair(folder: Path, name: str) -> tuple[Path, Path]:
    """Create a pair in files of the folder; return the paths of the secret and the public one.

    Raises KeyFileError for an invalid name or folder; OutputError where a file exists already or
    cannot be written.
    """
    if not _NAME.fullmatch(name):
        raise KeyFileError(
            f"{name!r}: not a name; use up to 64 letters, digits, dots, dashes and underscores,"
            " beginning with a letter or a digit"
        )
    _, secret = zmq.curve_keypair()
    pair = KeyPair(name, z85.decode(secret))
    secret_path, public_path = (folder / (name + end) for end in (SECRET_ENDING, PUBLIC_ENDING))
    try:
        folder.mkdir(mode=FOLDER, parents=True, exist_ok=True)
    except OSError as error:
        raise KeyFileError(f"{folder}: cannot make the folder: {error.strerror}") from None
    create_file(secret_path, f"{SECRET} {name} {pair.secret.hex()}\n", OWNER_ONLY)
    try:
        create_file(public_path, pair.public.line + "\n", READ_BY_ALL)
    except OutputError:
        secret_path.unlink()
        raise
    return secret_path, public_path


def read_pair(path: Path) -> KeyPair:
    """Read a secret key file. Raises KeyFileError, also when others may read it."""
    kind, name, key, mode = _read(path, SECRET)
    if kind == PUBLIC:
        raise KeyFileError(f"{path} is a public key; give the secret one, {name}{SECRET_ENDING}")
    if os.name == "posix" and mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise KeyFileError(f"{path}: others may read this secret key; run: chmod 600 {path}")
    return KeyPair(name, key)


def read_public(path: Path) -> PublicKey:
    """Read a public key file. Raises KeyFileError."""
    kind, name, key, _ = _read(path, PUBLIC)
    if kind == SECRET:
        raise KeyFileError(
            f"{path} is a secret key, which never leaves its machine; give the public one,"
            f" {name}{PUBLIC_ENDING}"
        )
    return PublicKey(name, key)


def is_missing(path: Path) -> bool:
    """Return whether there is no such file; False where this machine cannot find that out.

    `Path.exists` does not tell the two apart from Python 3.14 on.
    """
    try:
        path.stat()
    except OSError as error:
        return isinstance(error, FileNotFoundError)
    return False


def read_lines(path: Path, limit_bytes: int, remedy: str) -> tuple[list[str], int]:
    """Return the lines and mode of a text file (UTF-8) of limited size.

    Raises KeyFileError; remedy: what a person can do where there is no file.
    """
    try:
        with open_regular(path) as file:
            mode = os.fstat(file.fileno()).st_mode
            data = file.read(limit_bytes + 1)
    except FileNotFoundError:
        raise KeyFileError(f"{path}: there is no such file; {remedy}") from None
    except IsADirectoryError:
        raise KeyFileError(f"{path}: it is a folder; {remedy}") from None
    except OSError as error:
        raise KeyFileError(f"{path}: cannot read: {error.strerror}") from None
    if len(data) > limit_bytes:
        raise KeyFileError(f"{path} is not a file of keys: it is longer than {limit_bytes} bytes")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        reason = "it is not UTF-8; save the file in that encoding"
        raise KeyFileError(f"{path}, line {line}: {reason}") from None
    # Not `splitlines`, which ends a line at other characters too: a key that an editor shows within
    # a comment would count.
    return text.replace("\r\n", "\n").removesuffix("\n").split("\n") if text else [], mode


def parse_public(line: str) -> PublicKey:
    """Parse a public key's line.

    Raises ValueError, whose text does not quote the line: it may be a secret key.
    """
    kind, name, key = _words(line, PUBLIC)
    if kind != PUBLIC:
        raise ValueError("a secret key, which never leaves its machine")
    return PublicKey(name, key)


def _read(path: Path, wanted: str) -> tuple[str, str, bytes, int]:
    remedy = "make keys by: telepulse keys new NAME"
    lines, mode = read_lines(path, MAX_KEY_FILE_BYTES, remedy)
    try:
        if len(lines) != 1:
            raise ValueError("it is not one line")
        return *_words(lines[0], wanted), mode
    except ValueError as error:
        raise KeyFileError(f"{path} holds no key: {error}") from None


def _words(line: str, wanted: str) -> tuple[str, str, bytes]:
    """Return kind, name and key of a line; wanted: the kind that a refusal gives as an example."""
    words = line.split()
    if len(words) != 3 or words[0] not in (SECRET, PUBLIC):
        raise ValueError(f"it is not '{wanted} NAME KEY'")
    kind, name, key = words
    if not _NAME.fullmatch(name):
        raise ValueError("its second word is no name of a key")
    if not _HEX.fullmatch(key):
        raise ValueError("its last word is not a key of 64 hexadecimal digits")
    return kind, name, bytes.fromhex(key)
