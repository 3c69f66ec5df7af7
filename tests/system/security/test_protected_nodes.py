"""Both nodes as real processes, with keys."""

import re
from pathlib import Path

import pytest
import zmq

from display_node.telemetry.alerts import alerts
from protocol import sockets
from protocol.security.allow_list import revoke
from protocol.sockets import Context
from tests.support.keyring import Keyring
from tests.support.live_display import await_state, await_status, subscribe
from tests.support.log_lines import strays
from tests.support.nodes import RADIAL, assert_accounted, free_address, process, read_json
from tests.support.waiting import PATIENCE_S

SENSING, DISPLAY = "sensing_node.cli", "display_node.cli"


def sensing(keyring: Keyring, address: str, seconds: float, json: Path) -> tuple[str, ...]:
    options = ("--seconds", str(seconds), "--json", str(json), "--key", keyring.path("wrist"))
    return (str(RADIAL), "--bind", address, *options)


def display(
    keyring: Keyring, name: str, address: str, *more: str, peer: str = "wrist"
) -> tuple[str, ...]:
    keys = ("--key", keyring.path(name), "--peer", keyring.path(peer, "pub"))
    return (str(RADIAL), "--connect", address, "--no-screen", *keys, *more)


@pytest.mark.skipif(not zmq.has("ipc"), reason="no ipc here")
def test_with_keys_over_ipc_a_display_plays_all_of_the_stream(
    context: Context, keyring: Keyring, tmp_path: Path
) -> None:
    address = f"ipc://{tmp_path}/stream"
    sensed, played, telemetry = tmp_path / "sensed.json", tmp_path / "played.json", free_address()
    options = ("--once", "--json", str(played), "--telemetry", telemetry)
    reader = subscribe(context, telemetry)
    with process(DISPLAY, *display(keyring, "finger", address, *options)) as finger:
        await_state(reader, "waiting")
        with process(SENSING, *sensing(keyring, address, 2, sensed)) as wrist:
            assert wrist.wait(PATIENCE_S) == 0
            assert finger.wait(PATIENCE_S) == 0
    samples = read_json(played)["samples"]
    assert_accounted(samples)
    assert samples["played"] > 500
    assert read_json(played)["rejected"] == {}
    # A display that repeats its request closes the first connection, maybe during its handshake.
    assert set(read_json(sensed)["rejected"]) <= {"handshake"}


def test_a_revoked_display_is_cut_off_and_reports_it_while_the_other_continues(
    context: Context, keyring: Keyring, tmp_path: Path, address: str
) -> None:
    keyring.allow("thumb")
    sensed = tmp_path / "sensed.json"
    telemetry = {name: free_address() for name in ("finger", "thumb")}
    readers = {name: subscribe(context, at) for name, at in telemetry.items()}
    jsons = {name: tmp_path / f"{name}.json" for name in telemetry}
    commands = {
        name: display(
            *(keyring, name, address, "--once"),
            *("--telemetry", telemetry[name], "--json", str(jsons[name])),
        )
        for name in telemetry
    }
    with (
        process(DISPLAY, *commands["finger"]) as stays,
        process(DISPLAY, *commands["thumb"]) as goes,
        process(SENSING, *sensing(keyring, address, 8, sensed)) as node,
    ):
        for reader in readers.values():
            await_state(reader, "playing")
        revoke(keyring.allowed, "thumb")
        await_status(readers["thumb"], lambda status: status.state == "stale")
        await_status(readers["thumb"], lambda status: "revoked" in status.summary["rejected"])
        received = await_state(readers["thumb"], "stale").summary["frames"]["received"]
        assert node.wait(PATIENCE_S) == 0
        assert stays.wait(PATIENCE_S) == 0
        goes.terminate()
        output, display_log = goes.communicate(timeout=PATIENCE_S)
        _, sensing_log = node.communicate()
    assert read_json(jsons["thumb"])["frames"]["received"] == received
    assert display_log.count(" has revoked the key of thumb: ") == 1
    assert "Refused: the other node allowed this node's key before and has revoked it" in output
    revoked = f"thumb (key {keyring.pair('thumb').public.key.hex()[:16]}...) is no longer allowed"
    assert sensing_log.count(revoked) == 2
    assert sensing_log.count(f"refused 127.0.0.1: {revoked}") == 1
    rejected = read_json(sensed)["rejected"]
    assert "revoked_key" in rejected
    assert set(rejected) <= {"revoked_key", "handshake"}
    samples = read_json(jsons["finger"])["samples"]
    assert_accounted(samples)
    assert samples["played"] > samples["lost"]


def test_telemetry_beyond_this_machine_is_for_allowed_readers_and_the_own_screen(
    context: Context, keyring: Keyring, address: str
) -> None:
    everywhere = address.replace("127.0.0.1", "*")
    keys = ("--key", keyring.path("thumb"), "--peer", keyring.path("wrist", "pub"))
    arguments = (str(RADIAL), "--connect", free_address(), *keys, "--telemetry", everywhere)
    readers = {
        name: sockets.connect(context, zmq.SUB, address, peer)
        for name, peer in (
            ("allowed", keyring.client("finger", peer="thumb")),
            ("stranger", keyring.client("stranger", peer="thumb")),
            ("no key", None),
        )
    }
    for reader in readers.values():
        reader.subscribe(b"")
    readers["allowed"].setsockopt(zmq.RCVTIMEO, 200)
    with process(DISPLAY, *arguments, "--details", "--seconds", "60") as node:
        refused = {"unknown_key"}, {"no_key", "handshake"}
        status = await_status(
            readers["allowed"],
            lambda status: all(
                kinds & set(status.summary["rejected_readers"]) for kinds in refused
            ),
        )
        # None of them is the reason why this display has no stream.
        assert status.state == "waiting"
        assert alerts(status.state, status.summary) == []
        assert status.summary["rejected"] == {}
        node.terminate()
        output, errors = node.communicate(timeout=PATIENCE_S)
    assert not readers["stranger"].poll(0)
    assert not readers["no key"].poll(0)
    # Each cause with its meaning takes a line or two of its own.
    rejections = output[output.rindex("rejected readers ") :]
    assert re.search(r"\d no_key|\d handshake", rejections)
    assert re.search(r"\d unknown_key", rejections)
    assert strays(errors) == ""
