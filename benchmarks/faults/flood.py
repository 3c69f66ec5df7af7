"""`python -m benchmarks.faults.flood`: a peer that floods, and what it costs the other node.

A hostile sensing node sends each frame, or each answer of control, hundreds of times; a hostile
display asks for the clock as fast as it can. Both have all that an allowed peer has.
"""

import argparse
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from subprocess import DEVNULL, PIPE
from tempfile import TemporaryDirectory

import zmq

from benchmarks.faults.finger import finger_of
from benchmarks.faults.own_time import own_time_of, pin
from benchmarks.measure import median_quantile, show
from protocol import sockets
from protocol.config.scene_file import find_scene
from protocol.run_summary import Summary
from protocol.sockets import control_address
from protocol.wire.messages import ClockRequest, encode_control
from telepulse.processes import NodeProcess, free_addresses

FLOODED_S = 8.0
PATIENCE_S = 30.0
# Of a flood it may never be felt.
HOSTILE_WAIT_S = 4.0
HOSTILE = "TELEPULSE_FLOOD"
# Of each message that is sent, so many copies: 75 000 frames a second.
COPIES = {"data": 375, "control": 1_500}
# Of the display's scene.
TICK_NS = 1_000_000
# Share of ticks that a flood may cost by the display's own core time.
OWN_BAR = 0.01


def flooding_sensing_node(kind: str) -> None:
    """Run a sensing node that sends copies of its frames or of its answers."""
    from sensing_node import node

    send, limits = sockets.send, node.queue_limits

    def send_copies(socket: sockets.Socket, *parts: bytes) -> bool:
        flooded = (socket.socket_type == zmq.XPUB) == (kind == "data")
        sent = [send(socket, *parts) for _ in range(COPIES[kind] if flooded else 1)]
        return any(sent)

    sockets.send = send_copies
    node.queue_limits = lambda description: {**limits(description), zmq.SNDHWM: 100_000}
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


@dataclass(frozen=True, slots=True)
class FloodRun:
    """Both nodes' summaries of a run, and the share of the display's ticks that were missed, and
    that were missed by its own core time.
    """

    sensing: Summary
    display: Summary
    missed: float
    own_missed: float


def run(
    folder: Path, hostile: str | None, flood: Callable[[str], None], realtime: str | None = None
) -> FloodRun:
    """Run both nodes, of which one may be hostile; the display has a processor of its own.

    hostile: what the sensing node sends copies of. flood: runs while the nodes do, and is given
    the sensing node's address. realtime: the display's measures.
    """
    (address,) = free_addresses(1)
    telemetry, scene = f"ipc://{folder}/telemetry", str(find_scene("radial"))
    module = "sensing_node.cli" if hostile is None else "benchmarks.faults.flood"
    environment = {**os.environ, HOSTILE: hostile or ""}
    sensing_command = (module, scene, "--bind", address)
    display_command = ("display_node.cli", scene, "--connect", address, "--no-screen")
    display_command += ("--telemetry", telemetry)
    display_command += () if realtime is None else ("--realtime", realtime)
    display, sensing = nodes = [
        NodeProcess(
            f"{name} node",
            *command,
            summary=folder / f"{name}.json",
            stdout=DEVNULL,
            stderr=PIPE,
            env=environment,
        )
        for name, command in (("display", display_command), ("sensing", sensing_command))
    ]
    first, *others = sorted(os.sched_getaffinity(0))
    # Every other process here, this one too, shares the rest.
    pin(display.pid, first)
    for process in (os.getpid(), sensing.pid):
        pin(process, others[0] if others else first)
    try:
        with finger_of(telemetry) as finger, own_time_of(display.pid) as own:
            wait_s = PATIENCE_S if hostile is None else HOSTILE_WAIT_S
            if finger.felt_from_ns(0, wait_s) is None and hostile is None:
                raise RuntimeError("the pulse was not felt")
            flood(address)
        display.terminate()
        summary = display.await_summary(PATIENCE_S)
        sensing.terminate()
        sensed = sensing.await_summary(PATIENCE_S)
    finally:
        os.sched_setaffinity(0, {first, *others})
        for node in nodes:
            node.kill()
            node.communicate()
    missed, own_missed = own.own_misses(finger, TICK_NS)
    ticks = max(1, (summary.loop.ticks or 0) + missed)
    return FloodRun(sensed, summary, missed / ticks, own_missed / ticks)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--realtime", help="the display's measures, such as fifo=40")
    realtime = parser.parse_args().realtime
    rows = []
    for name, hostile in (("none", None), ("frames", "data"), ("answers", "control")):
        with TemporaryDirectory(prefix="telepulse-") as folder:
            flooded = run(Path(folder), hostile, lambda _: time.sleep(FLOODED_S), realtime)
        rows.append((f"display: flood of {name}", *_figures(flooded)))
    asked = 0

    def flood(address: str) -> None:
        nonlocal asked
        end_s = time.monotonic() + FLOODED_S
        asked = flooding_display(address, lambda: time.monotonic() > end_s)

    with TemporaryDirectory(prefix="telepulse-") as folder:
        flooded = run(Path(folder), None, flood, realtime)
    rows.append((f"display beside one that asks {asked / FLOODED_S:.0f} /s", *_figures(flooded)))
    show(
        f"{FLOODED_S:g} s of a flood: ticks that were missed, and by the display's own core time"
        f" (bar {OWN_BAR:.0%}); share of the samples played in time, what was refused",
        ("flood", "missed", "own", "tick p99 µs", "in time", "p99 delay ms", "refused"),
        rows,
    )
    print("sensing node refused", flooded.sensing.rejected)


def _figures(flooded: FloodRun) -> tuple[str, ...]:
    display = flooded.display
    samples = display.samples
    due = (samples.played or 0) + (samples.late or 0) + (samples.lost or 0)
    played = "–" if not due else f"{100 * (samples.played or 0) / due:.1f} %"
    causes = ", ".join(f"{count} {cause}" for cause, count in display.rejected.items())
    return (
        f"{100 * flooded.missed:.1f} %",
        f"{100 * flooded.own_missed:.1f} %",
        median_quantile("p99", [display.loop.tick_us]),
        played,
        median_quantile("p99", [display.one_way_delay_ms], 1),
        causes or "nothing",
    )


if __name__ == "__main__":
    if os.environ.get(HOSTILE):
        flooding_sensing_node(os.environ[HOSTILE])
    else:
        main()
