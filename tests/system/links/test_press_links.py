"""The press with keys between two namespaces: loss, a cut of one direction, a revoked key."""

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import zmq

from protocol.security.allow_list import revoke
from protocol.sockets import Context
from protocol.wire.messages import decode_frame
from telepulse.simulation.link_scene import parse_link
from tests.support.keyring import Keyring
from tests.support.netem import PacketFilter, emulate
from tests.support.node_rig import PORT
from tests.support.nodes import ROOT, process, read_json
from tests.support.sensing_client import KeyedClient
from tests.support.tcp import needs_emulator
from tests.support.waiting import until

SCENE = str(ROOT / "scenes" / "press.toml")
EASED_N = 0.26
LINK = parse_link("delay=50ms,jitter=5ms,loss=1%")


def hold_down(wrist: KeyedClient) -> Callable[[], float]:
    """Return a function that returns the newest hold-down, which a reader at the wrist receives."""
    newest_n = 0.0

    def newest() -> float:
        nonlocal newest_n
        wrist.request()
        if wrist.frames:
            values = decode_frame(wrist.frames[-1]).values
            newest_n = float((values[:, 1] - values[:, 0]).mean())
            wrist.frames.clear()
        return newest_n

    return newest


@needs_emulator
def test_with_keys_over_a_lossy_link_a_cut_eases_off_and_a_revoked_key_releases(
    tmp_path: Path,
) -> None:
    keyring = Keyring(tmp_path / "keys")
    for name in ("finger", "reader"):
        keyring.allow(name)
    json = tmp_path / "finger.json"
    peer = ("--connect", f"tcp://10.77.0.1:{PORT}", "--peer", keyring.path("wrist", "pub"))
    telemetry = ("--telemetry", f"ipc://{tmp_path}/telemetry", "--json", str(json), "--quiet")
    with emulate(LINK) as link, ExitStack() as stack:
        with link.sensing.entered():
            context: Context = stack.enter_context(zmq.Context())
            at_wrist = KeyedClient(context, f"tcp://127.0.0.1:{PORT}", keyring.client("reader"))
            stack.callback(context.destroy, linger=0)
            options = (SCENE, "--bind", f"tcp://*:{PORT}", "--key", keyring.path("wrist"))
            wrist = stack.enter_context(process("sensing_node.cli", *options, "--quiet"))
        with link.display.entered():
            options = (SCENE, "--key", keyring.path("finger"), *peer, *telemetry)
            finger = stack.enter_context(process("display_node.cli", *options))
        newest_n = hold_down(at_wrist)
        until(lambda: newest_n() > 0.5)
        link.drop(PacketFilter(towards="display"))
        # The bound of 0.5 s, and other cuts, are proved in virtual time.
        until(lambda: newest_n() < EASED_N)
        link.drop()
        until(lambda: newest_n() > 0.5)
        revoke(keyring.allowed, "finger")
        until(lambda: newest_n() < 0.03)
        finger.terminate()
        finger.wait(timeout=30)
        wrist.terminate()
        _, log = wrist.communicate(timeout=30)
    press = read_json(json)["press"]
    assert press["sent"] == press["applied"] + press["superseded"] + press["lost"]
    assert press["applied"] > 20
    assert log.count(f"WARNING {keyring.pair('finger').public} is no longer allowed") == 1
