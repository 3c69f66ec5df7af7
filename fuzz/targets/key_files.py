"""Key files and allow-lists, and ZeroMQ's authentication requests."""

from fuzz.refusals import check_line
from fuzz.targets import scratch_folder
from protocol.errors import KeyFileError
from protocol.security import zap
from protocol.security.allow_list import read_allow_list
from protocol.security.keys import KEY_BYTES, PUBLIC, SECRET, read_pair, read_public

_FILE = scratch_folder() / "wrist.key"
_FILE.touch(mode=0o600)


def seeds() -> list[bytes]:
    """Return a secret key, a public one, a list of two, and a request in lines."""
    lines = [f"{kind} wrist {'1' * 64}\n".encode() for kind in (SECRET, PUBLIC)]
    other = f"# them\n\n{PUBLIC} finger {'a' * 64}\n".encode()
    request = [zap.VERSION, b"1", zap.DOMAIN, b"127.0.0.1", b"", b"CURVE", b"k" * KEY_BYTES]
    return [*lines, lines[1] + other, b"\n".join(request)]


def try_one(data: bytes) -> None:
    """Read keys: 32 bytes, or a KeyFileError of one line; a request is judged and answered."""
    _FILE.write_bytes(data)
    for read in (_read_pair, _read_public, _read_list):
        try:
            keys = read()
        except KeyFileError as error:
            check_line(error)
        else:
            assert all(len(key) == KEY_BYTES for key in keys)
    request = data.split(b"\n")
    peer = zap.decode_request(request)
    if peer is not None:
        peer.address.encode()
    for cause in (None, "unknown_key", "list_unreadable"):
        assert len(zap.encode_reply(request, cause)) == 6


def _read_pair() -> list[bytes]:
    pair = read_pair(_FILE)
    return [pair.secret, pair.public.key]


def _read_public() -> list[bytes]:
    return [read_public(_FILE).key]


def _read_list() -> list[bytes]:
    return list(read_allow_list(_FILE))
