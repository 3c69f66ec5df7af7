"""`telepulse link` between two nodes with keys: a client of one, a server of the other."""

from pathlib import Path

from protocol.security.link_keys import ClientKeys
from protocol.sockets import Context
from protocol.wire.messages import Welcome, decode_control
from tests.support.keyring import Keyring
from tests.support.nodes import RADIAL, free_address, process
from tests.support.sensing_client import KeyedClient
from tests.support.waiting import until


def test_a_link_has_keys_on_both_sides(context: Context, keyring: Keyring, tmp_path: Path) -> None:
    far, near = free_address(), free_address()
    keyring.allow("link")
    displays = Keyring(tmp_path / "displays")
    displays.allow("finger")
    keys = ("--key", keyring.path("link"), "--peer", keyring.path("wrist", "pub"))
    link = ("link", "--connect", far, "--bind", near, *keys, "--allow", str(displays.allowed))
    finger_keys = ClientKeys(displays.pair("finger"), keyring.pair("link").public)
    finger, stranger = (KeyedClient(context, near, keys) for keys in (finger_keys, None))

    def received() -> bool:
        stranger.request()
        finger.request()
        return bool(finger.answers and finger.frames)

    with (
        process("sensing_node.cli", str(RADIAL), "--bind", far, "--key", keyring.path("wrist")),
        process("telepulse", *link),
    ):
        until(received)
    assert isinstance(decode_control(finger.answers[0]), Welcome)
    assert stranger.answers == stranger.frames == []
