"""`telepulse link` between two nodes with keys: a client of one, a server of the other."""

import time
from pathlib import Path

import zmq

from protocol import sockets
from protocol.security.keys import ClientKeys
from protocol.sockets import Context, control_address
from protocol.wire.messages import Hello, Welcome, decode_control, encode_control
from tests.support.keyring import Keyring
from tests.support.log_lines import refused
from tests.support.nodes import RADIAL, free_address, process
from tests.support.waiting import PATIENCE_S


def test_a_link_has_keys_on_both_sides(context: Context, keyring: Keyring, tmp_path: Path) -> None:
    far, near = free_address(), free_address()
    keyring.allow("link")
    displays = Keyring(tmp_path / "displays")
    displays.allow("finger")
    keys = ("--key", keyring.path("link"), "--peer", keyring.path("wrist", "pub"))
    link = ("link", "--connect", far, "--bind", near, *keys, "--allow", str(displays.allowed))
    finger = ClientKeys(displays.pair("finger"), keyring.pair("link").public)
    sockets_of, received = [], []
    for keyed in (finger, None):
        control = sockets.connect(context, zmq.DEALER, control_address(near), keyed)
        data = sockets.connect(context, zmq.SUB, near, keyed)
        data.subscribe(b"")
        sockets_of.append((control, data))
        received.append(([], []))
    with (
        process("sensing_node.cli", str(RADIAL), "--bind", far, "--key", keyring.path("wrist")),
        process("telepulse", *link),
    ):
        end_s = time.monotonic() + PATIENCE_S
        while not all(received[0]):
            assert time.monotonic() < end_s
            for (control, data), (answers, frames) in zip(sockets_of, received, strict=True):
                sockets.send(control, encode_control(Hello("raw")))
                answers += sockets.receive_parts(control)
                frames += sockets.receive_parts(data)
            time.sleep(0.02)
    assert isinstance(decode_control(received[0][0][0]), Welcome)
    assert received[1] == ([], [])


def test_a_link_beyond_this_machine_without_keys_does_not_start() -> None:
    for option, other in (("--connect", "--bind"), ("--bind", "--connect")):
        line = refused("telepulse", "link", option, "tcp://192.0.2.1:5555", other, free_address())
        assert line.startswith("telepulse: tcp://192.0.2.1:5555 reaches beyond")
