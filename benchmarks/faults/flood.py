"""`python -m benchmarks.faults.flood`: a peer that floods, and what it costs the other node.

A hostile sensing node sends each frame, or each answer of control, hundreds of times; a hostile
display asks for the clock as fast as it can. Both have all that an allowed peer has.
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import zmq

from benchmarks.faults.finger import finger_of
from benchmarks.measure import show
from protocol import sockets
from protocol.messages import ClockRequest, encode_control
from protocol.sockets import control_address
from protocol.summary import Summary
from telepulse.node_process import await_end, read_summary
from telepulse.ports import free_addresses
from telepulse.scene import find_scene

FLOODED_S = 8.0
PATIENCE_S = 30.0
# Of a flood it may never be felt.
HOSTILE_WAIT_S = 4.0
HOSTILE = "TELEPULSE_FLOOD"
# Of each message that is sent, so many copies: 75 000 frames a second.
COPIES = {"data": 375, "control": 1_500}


def flooding_sensing_node(kind: str) -> None:
    """Run a sensing node that sends copies of its frames or of its answers."""
    from sensing_node import backlog, node

    send = sockets.send

    def send_copies(socket: sockets.Socket, *parts: bytes) -> bool:
        flooded = (socket.socket_type == zmq.XPUB) == (kind == "data")
        sent = [send(socket, *parts) for _ in range(COPIES[kind] if flooded else 1)]
        return any(sent)

    sockets.send = send_copies
    node.limits = lambda description: {**backlog.limits(description), zmq.SNDHWM: 100_000}
    from sensing_node.cli import main

    main()


def flooding_display(address: str, over: Callable[[], bool]) -> int:
    """Ask for the clock until it is over; how often."""
    count = 0
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.connect(control_address(address))
        while not over():
            for _ in range(100):
                try:
                    socket.send(encode_control(ClockRequest(time.monotonic_ns())), zmq.NOBLOCK)
                    count += 1
                except zmq.Again:
                    time.sleep(0.0005)
            while socket.poll(0):
                socket.recv_multipart()
    return count


def run(folder: Path, hostile: str | None, flood: Callable[[str], None]) -> tuple[Summary, Summary]:
    """Both nodes' summaries of a run in which one of them may be hostile.

    hostile: what the sensing node sends copies of. flood: runs while the nodes do, and is given
    the sensing node's address.
    """
    (address,) = free_addresses(1)
    telemetry, scene = f"ipc://{folder}/telemetry", str(find_scene("radial"))
    jsons = folder / "sensing.json", folder / "display.json"
    module = "sensing_node.cli" if hostile is None else "benchmarks.faults.flood"
    environment = {**os.environ, HOSTILE: hostile or ""}
    sensing_command = (module, scene, "--bind", address, "--json", str(jsons[0]))
    display_command = ("display_node.cli", scene, "--connect", address, "--no-screen")
    display_command += ("--telemetry", telemetry, "--json", str(jsons[1]))
    nodes = [
        subprocess.Popen(
            [sys.executable, "-m", *command],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )
        for command in (display_command, sensing_command)
    ]
    display, sensing = nodes
    try:
        with finger_of(telemetry) as finger:
            wait_s = PATIENCE_S if hostile is None else HOSTILE_WAIT_S
            if finger.felt_from_ns(0, wait_s) is None and hostile is None:
                raise RuntimeError("the pulse was not felt")
            flood(address)
        for node, name in ((display, "display node"), (sensing, "sensing node")):
            node.terminate()
            await_end(node, name, PATIENCE_S)
    finally:
        for node in nodes:
            node.kill()
            node.communicate()
    return read_summary(jsons[0]), read_summary(jsons[1])


def main() -> None:
    """Print the table."""
    rows = []
    for name, hostile in (("none", None), ("frames", "data"), ("answers", "control")):
        with TemporaryDirectory(prefix="telepulse-") as folder:
            _, display = run(Path(folder), hostile, lambda address: time.sleep(FLOODED_S))
        rows.append((f"display: flood of {name}", *_figures(display)))
    asked = 0

    def flood(address: str) -> None:
        nonlocal asked
        end_s = time.monotonic() + FLOODED_S
        asked = flooding_display(address, lambda: time.monotonic() > end_s)

    with TemporaryDirectory(prefix="telepulse-") as folder:
        sensing, display = run(Path(folder), None, flood)
    rows.append((f"display beside one that asks {asked / FLOODED_S:.0f} /s", *_figures(display)))
    show(
        f"{FLOODED_S:g} s of a flood: ticks that were missed, share of the samples played in time,"
        " what was refused",
        ("flood", "missed", "in time", "p99 delay ms", "refused"),
        rows,
    )
    print("sensing node refused", sensing.rejected)


def _figures(display: Summary) -> tuple[str, ...]:
    loop, samples = display.loop, display.samples
    misses = loop.deadline_misses or 0
    missed = 100 * misses / max(1, (loop.ticks or 0) + misses)
    due = (samples.played or 0) + (samples.late or 0) + (samples.lost or 0)
    played = "–" if not due else f"{100 * (samples.played or 0) / due:.1f} %"
    causes = ", ".join(f"{count} {cause}" for cause, count in display.rejected.items())
    delay = display.one_way_delay_ms.p99
    return f"{missed:.1f} %", played, "–" if delay is None else f"{delay:.1f}", causes or "nothing"


if __name__ == "__main__":
    if os.environ.get(HOSTILE):
        flooding_sensing_node(os.environ[HOSTILE])
    else:
        main()
