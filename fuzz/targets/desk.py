"""The sensing node's front desk: control messages from any senders, in any order."""

from fuzz.refusals import check_causes
from fuzz.targets.control import DESCRIPTION
from fuzz.targets.control import seeds as messages
from protocol.wire.messages import Bye, DisplayReport, decode_control, encode_control
from sensing_node.control_server import ADDRESS_BYTES, MAX_CLIENTS, MAX_HOPS, ControlServer

SESSION = 7
STEP_NS = 300_000_000


def seeds() -> list[bytes]:
    """Two displays that say all there is to say."""
    return [_written([(sender, message) for message in messages() for sender in (b"a", b"bb")])]


def try_one(data: bytes) -> None:
    """Each message is answered, noted or counted, and no more guests are kept than may be."""
    desk = ControlServer(DESCRIPTION, SESSION)
    answered = noted = count = 0
    for count, (sender, message) in enumerate(_read(data), 1):
        refused = desk.rejected.total()
        reply = desk.answer(sender, message, count * STEP_NS, count)
        if reply is not None:
            answered += 1
            decode_control(encode_control(reply))
        elif desk.rejected.total() == refused:
            noted += 1
            assert isinstance(decode_control(message), Bye | DisplayReport)
        if count % 4 == 0:
            desk.forget_silent(count * STEP_NS)
        assert len(desk.clients) <= MAX_CLIENTS
        for envelope, guest in desk.clients.items():
            assert len(envelope) <= MAX_HOPS
            assert all(len(address) == ADDRESS_BYTES for address in envelope[1:])
            guest.shown_name.encode("ascii")
    assert answered + noted + desk.rejected.total() == count
    check_causes(desk.rejected)


def _written(said: list[tuple[bytes, bytes]]) -> bytes:
    return b"".join(
        bytes([len(sender), len(message)]) + sender + message for sender, message in said
    )


def _read(data: bytes) -> list[tuple[tuple[bytes, ...], bytes]]:
    """Senders and their messages: how long each is, then both; an address ends in a zero byte."""
    said = []
    while len(data) >= 2:
        sender_bytes, message_bytes, data = data[0], data[1], data[2:]
        sender, data = data[:sender_bytes], data[sender_bytes:]
        message, data = data[:message_bytes], data[message_bytes:]
        said.append((tuple(sender.split(b"\0")), message))
    return said
