"""Rate of updates of a live page while other viewers open it and do not read."""

import base64
import itertools
import json
import re
import socket
import statistics
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from http.client import HTTPConnection
from subprocess import DEVNULL, PIPE
from typing import Any
from urllib.parse import urlsplit

from benchmarks.benchmark import Benchmark
from protocol.config.scene_file import find_scene
from protocol.host.child_process import ChildProcess
from telepulse.processes import free_addresses

OTHERS = 20
ALONE_S, OPENED_S, AFTER_S = 5.0, 15.0, 10.0
PATIENCE_S = 20.0
TEXT, PING, PONG = 1, 9, 10
KEY = base64.b64encode(bytes(16)).decode()


class Viewer:
    """A page as its browser sees it, over the websocket of Bokeh's protocol."""

    def __init__(self, port: int) -> None:
        """Open the page. Raises ConnectionError where it is refused."""
        asking = HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        asking.request("GET", "/")
        found = re.search(r'"token":\s*"([^"]+)"', asking.getresponse().read().decode())
        asking.close()
        if found is None:
            raise ConnectionError("the page was refused")
        self._socket = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
        self._reader = self._socket.makefile("rb")
        head = f"GET /ws HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
        head += f"Connection: Upgrade\r\nSec-WebSocket-Key: {KEY}\r\nSec-WebSocket-Version: 13\r\n"
        self._socket.sendall(f"{head}Sec-WebSocket-Protocol: bokeh, {found[1]}\r\n\r\n".encode())
        while self._reader.readline().strip():
            pass
        self._wishes = ""

    def updates(self) -> Iterator[float]:
        """Yield the time of each update in s, and acknowledge texts as the page's script does."""
        self._message()
        self._send({"msgid": "1", "msgtype": "PULL-DOC-REQ"}, {})
        content: Any = None
        while not self._wishes:
            header, content = self._message()
            if header["msgtype"] == "PULL-DOC-REPLY":
                self._wishes = _wishes_in(content)
        number = 1
        self._acknowledge(number)
        while True:
            update = json.dumps(self._message()[1])
            if '"number"' in update:
                number += 1
                self._acknowledge(number)
            if '"wrist_t"' in update:
                yield time.monotonic()

    def close(self) -> None:
        """Close the connection."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._reader.close()
        self._socket.close()

    def _acknowledge(self, number: int) -> None:
        entries = [["paused", [False]], ["window_s", [10]], ["contactor", [0]]]
        entries += [["unfolded", [""]], ["seen", [number]]]
        event = {"kind": "ModelChanged", "model": {"id": self._wishes}, "attr": "data"}
        event |= {"new": {"type": "map", "entries": entries}}
        self._send({"msgid": f"m{number}", "msgtype": "PATCH-DOC"}, {"events": [event]})

    def _send(self, header: dict[str, Any], content: dict[str, Any]) -> None:
        for part in (header, {}, content):
            self._frame(TEXT, json.dumps(part).encode())

    def _frame(self, kind: int, payload: bytes) -> None:
        # Masked by zeros. A pong's length has one byte, as RFC 6455 demands.
        length = len(payload)
        size = bytes([0x80 | length]) if length < 126 else b"\xfe" + struct.pack(">H", length)
        self._socket.sendall(bytes([0x80 | kind]) + size + bytes(4) + payload)

    def _message(self) -> tuple[dict[str, Any], Any]:
        """Return the next message of Bokeh: its header and its content."""
        frames: list[bytes] = []
        while True:
            kind, size = self._reader.read(2)
            kind, size = kind & 15, size & 127
            if size > 125:
                form, length = ((">H", 2), (">Q", 8))[size - 126]
                (size,) = struct.unpack(form, self._reader.read(length))
            data = self._reader.read(size)
            if kind == PING:
                self._frame(PONG, data)
                continue
            frames.append(data)
            if len(frames) >= 3:
                header = json.loads(frames[0])
                if len(frames) == 3 + 2 * header.get("num_buffers", 0):
                    return header, json.loads(frames[2])


def _wishes_in(content: Any) -> str:
    """Return the id of the data source by which a page acknowledges updates."""
    if isinstance(content, dict):
        if "seen" in json.dumps(content.get("attributes", {}).get("data", "")):
            return str(content["id"])
        content = list(content.values())
    if isinstance(content, list):
        return next(filter(None, map(_wishes_in, content)), "")
    return ""


@contextmanager
def page() -> Iterator[int]:
    """Provide the port of the live page of two nodes on this machine."""
    data, telemetry = free_addresses(2)
    scene = str(find_scene("radial"))
    with ExitStack() as stack:
        for command in (
            ("sensing_node.cli", scene, "--bind", data),
            ("display_node.cli", scene, "--connect", data, "--telemetry", telemetry, "--no-screen"),
            ("telepulse", "view", telemetry),
        ):
            process = ChildProcess(command[0], "-m", *command, stdout=PIPE, stderr=DEVNULL)
            stack.enter_context(process)
        yield urlsplit(process.read_line(PATIENCE_S).split()[-1]).port or 0


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    times_s: list[float] = []
    rows = []

    def watch(viewer: Viewer) -> None:
        with suppress(OSError, ValueError):
            for time_s in viewer.updates():
                times_s.append(time_s)

    def note(name: str, seconds: float) -> None:
        times_s.clear()
        time.sleep(seconds)
        apart = sorted(b - a for a, b in itertools.pairwise(times_s))
        shown = (f"{statistics.median(apart):.2f}", f"{apart[-1]:.2f}") if apart else ("–", "–")
        rows.append((name, *shown))

    with page() as port:
        reader = Viewer(port)
        watching = threading.Thread(target=watch, args=(reader,), daemon=True)
        watching.start()
        time.sleep(ALONE_S)
        note("one page", ALONE_S)
        others: list[Viewer] = []

        def open_others() -> None:
            for _ in range(OTHERS):
                with suppress(ConnectionError):
                    others.append(Viewer(port))

        opening = threading.Thread(target=open_others)
        opening.start()
        note(f"while {OTHERS} more are opened, which do not read", OPENED_S)
        opening.join()
        note("from then on", AFTER_S)
        for viewer in (reader, *others):
            viewer.close()
        watching.join(PATIENCE_S)
    benchmark.table(
        f"s from update to update at one page ({len(others)} of {OTHERS} others were served)",
        ("pages", "median", "most"),
        rows,
    )
