"""Announcement and discovery of nodes by real processes and real multicast DNS."""

import json
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from pathlib import Path

import pytest

from protocol.discovery.announcement import SERVICE, Announcement, to_txt
from protocol.discovery.browser import Browser
from protocol.host.child_process import ChildProcess
from protocol.wire.messages import VERSION
from tests.support.keyring import Keyring
from tests.support.log_lines import messages, strays
from tests.support.netem import Namespace, unavailable
from tests.support.nodes import RADIAL, read_json, start
from tests.support.waiting import PATIENCE_S, until

zeroconf = pytest.importorskip("zeroconf")
DISPLAY, SENSING = "display_node.cli", "sensing_node.cli"
BIND = "tcp://127.0.0.1:5555"


class Place:
    """Network for programs: a namespace of their own if permitted, else this machine's."""

    def __init__(self, namespace: Namespace | None) -> None:
        self._namespace = namespace

    def entered(self) -> AbstractContextManager[None]:
        return self._namespace.entered() if self._namespace else nullcontext()

    @contextmanager
    def process(self, module: str, *arguments: str) -> Iterator[ChildProcess]:
        with self.entered():
            child = start(module, *arguments)
        with child:
            yield child

    def run(self, module: str, *arguments: str) -> tuple[int, str, str]:
        with self.process(module, *arguments) as child:
            output, errors = child.communicate(timeout=3 * PATIENCE_S)
            return child.returncode, output, errors

    @contextmanager
    def service(self, name: str, port: int, txt: dict[str, str]) -> Iterator[None]:
        """Announce a service on loopback within a `with`."""
        info = zeroconf.ServiceInfo(
            *(SERVICE, f"{name}.{SERVICE}"),
            port=port,
            properties=txt,
            server=f"{port}.local.",
            parsed_addresses=["127.0.0.1"],
        )
        with self.entered():
            network = zeroconf.Zeroconf(interfaces=["127.0.0.1"])
        with closing(network):
            network.register_service(info, cooperating_responders=True)
            yield


@pytest.fixture
def place() -> Iterator[Place]:
    if unavailable() is not None:
        yield Place(None)
        return
    with closing(Namespace([])) as namespace:
        yield Place(namespace)


def await_line(node: ChildProcess, word: str) -> str:
    """Return the message of the record that has the word."""
    while word not in (line := node.read_line(3 * PATIENCE_S, from_stderr=True)):
        pass
    return messages(line)[0]


def display(*more: str) -> tuple[str, ...]:
    return (str(RADIAL), "--no-screen", *more)


def test_an_announced_node_is_found_until_it_is_killed(place: Place) -> None:
    with place.process(SENSING, str(RADIAL), "--bind", BIND, "--announce") as wrist:
        line = await_line(wrist, "announced as")
        assert line.endswith("at 127.0.0.1")
        name = line.split("'")[1]
        with place.entered(), Browser() as look:
            until(lambda: [one.name for one in look.found] == [name])
            (one,) = look.found
            assert (one.addresses, one.port, one.fingerprint) == (("127.0.0.1",), 5555, None)
            wrist.send_signal(signal.SIGKILL)
            wrist.wait(PATIENCE_S)
            # Without the announcer's withdrawal, the name would be valid for another hour.
            until(lambda: not look.found)
            assert not look.refused
        # No thread of zeroconf stays beside a display's loop.
        assert not [one.name for one in threading.enumerate() if "zeroconf" in one.name]


def test_invalid_announcements_are_refused_and_several_nodes_are_listed(
    place: Place, tmp_path: Path
) -> None:
    left, right = (Announcement.of_node("pulse", host, 5555, None) for host in ("left", "right"))
    with (
        place.service("left\u202e", 80, {"v": str(VERSION), "stream": "x"}),
        place.service("older", 81, {"v": "0"}),
        place.service(left.name, 5555, to_txt(left)),
        place.service(right.name, 5555, to_txt(right)),
    ):
        json_path = tmp_path / "found.json"
        listing = (DISPLAY, "--discover", "--seconds", "3", "--json", str(json_path))
        with (
            place.process(DISPLAY, *display("--named", "Pulse on right")) as chosen,
            ThreadPoolExecutor() as pool,
        ):
            either = pool.submit(place.run, DISPLAY, *display("--discover"))
            status, output, errors = place.run(*listing)
            # The display has not found the node yet, and waits for it.
            found = await_line(chosen, "found ")
        assert (status, strays(errors)) == (0, "")
        assert found.strip() == f"found 'pulse on right' at {BIND}"
        assert errors.count("not a sensing node: ") == 2
        assert "not a sensing node: older: the peer has version 0 of the protocol" in errors
        assert "2 sensing nodes announced; refused: 1 malformed, 1 version" in output
        listed = json.loads(json_path.read_text(encoding="utf-8"))
        assert [row["name"] for row in listed["nodes"]] == ["pulse on left", "pulse on right"]
        assert listed["refused"] == {"malformed": 1, "version": 1}

        status, _, errors = either.result()
        assert status == 2
        assert strays(errors).count("\n") == 1
        assert "'pulse on left', 'pulse on right'; choose one by --named NAME" in errors


def test_an_announced_node_without_the_right_key_is_refused(place: Place, tmp_path: Path) -> None:
    ring, result = Keyring(tmp_path / "keys"), tmp_path / "display.json"
    ring.allow("finger")
    # It announces the fingerprint of wrist at the address of a node with another key.
    spoofed = Announcement.of_node("pulse", "spoofed", 5555, ring.pair("wrist").public.key)
    keys = ("--key", ring.path("finger"), "--peer", ring.path("wrist", "pub"))
    impostor = ("--bind", BIND, "--key", ring.path("impostor"), "--quiet")
    with (
        place.process(SENSING, str(RADIAL), *impostor),
        place.service(spoofed.name, 5555, to_txt(spoofed)),
    ):
        with_keys = display("--discover", *keys, "--json", str(result))
        with place.process(DISPLAY, *with_keys) as finger:
            # A display without keys does not connect to a node with keys.
            status, _, errors = place.run(DISPLAY, *display("--discover"))
            await_line(finger, "found 'pulse on spoofed'")
            await_line(finger, "breaks off; it is not wrist, whose public key --peer gives")
            finger.terminate()
            assert finger.wait(PATIENCE_S) == 0
        assert status == 2
        assert "'pulse on spoofed' requires keys; give --key" in errors
    summary = read_json(result)
    assert summary["frames"]["received"] == 0
    assert summary["rejected"]["handshake"] >= 1
