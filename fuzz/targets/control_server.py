"""The sensing node's control server: messages from any senders, in any order."""

from fuzz.refusals import check_causes
from fuzz.targets.control import seeds as messages
from protocol.wire.messages import (
    LARGEST_N,
    Bye,
    DisplayReport,
    decode_control,
    encode_control,
)
from sensing_node.control_server import ADDRESS_BYTES, MAX_CLIENTS, MAX_HOPS, ControlServer
from sensing_node.press.set_points import PressedProbe, SetPointServer
from tests.support.message_examples import DESCRIPTION

SESSION = 7
STEP_NS = 300_000_000


class CheckedProbe(PressedProbe):
    """A probe that checks its set-points."""

    state, hold_down_n, depth_m = "pressing", 0.0, 0.0

    def press(self, force_n: float) -> None:
        """Take a set-point in N."""
        assert 0.0 <= force_n <= LARGEST_N


def seeds() -> list[bytes]:
    """Return two displays that send every message."""
    return [_written([(sender, message) for message in messages() for sender in (b"a", b"bb")])]


def try_one(data: bytes) -> None:
    """Answer, store or count each message; the number of clients stays limited."""
    set_points = SetPointServer(SESSION, CheckedProbe())
    server = ControlServer(DESCRIPTION, SESSION, set_points)
    for count, (sender, message) in enumerate(_read(data), 1):
        before = server.rejected.total()
        reply = server.answer(sender, message, count * STEP_NS, count)
        refused = server.rejected.total() - before
        assert refused in (0, 1)
        if reply is not None:
            decode_control(encode_control(reply))
        else:
            assert refused or isinstance(decode_control(message), Bye | DisplayReport)
        if count % 4 == 0:
            server.forget_silent(count * STEP_NS)
        assert len(server.clients) <= MAX_CLIENTS
        for envelope, client in server.clients.items():
            assert len(envelope) <= MAX_HOPS
            assert all(len(address) == ADDRESS_BYTES for address in envelope[1:])
            client.shown_name.encode("ascii")
    account = set_points.figures()
    parts = account.applied, account.superseded, account.lost
    assert account.sent == sum(part or 0 for part in parts)
    check_causes(server.rejected + set_points.rejected)


def _written(said: list[tuple[bytes, bytes]]) -> bytes:
    return b"".join(
        bytes([len(sender), len(message)]) + sender + message for sender, message in said
    )


def _read(data: bytes) -> list[tuple[tuple[bytes, ...], bytes]]:
    """Yield senders and messages: a length each, then both; an address ends in a zero byte."""
    said = []
    while len(data) >= 2:
        sender_bytes, message_bytes, data = data[0], data[1], data[2:]
        sender, data = data[:sender_bytes], data[sender_bytes:]
        message, data = data[:message_bytes], data[message_bytes:]
        said.append((tuple(sender.split(b"\0")), message))
    return said
