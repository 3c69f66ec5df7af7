"""The press over real TCP that loses packets: steps followed, by round trip and connections.

Both real nodes, in network namespaces with an emulated link between them. The modelled finger steps
every 4 s; scored is the hold-down that leaves the sensing node against what the finger means. Needs
root, for the link emulator.
"""

import math
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from subprocess import PIPE
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import zmq
from numpy.typing import NDArray

from benchmarks.measure import show
from display_node.press.local_press import RISE_NS
from protocol.config.scene_file import find_scene
from protocol.run_summary import Summary
from protocol.wire.messages import decode_frame
from protocol.wire.telemetry import TRACE, read_trace
from telepulse.netem import EmulatedLink, emulate, unavailable
from telepulse.netem.emulated_link import PORT
from telepulse.processes import NodeProcess
from telepulse.reports.studies.press_scores import FOLLOW_ERROR, FOLLOWED_S
from telepulse.simulation.link_scene import parse_link

LEVELS_N = (0.6, 1.2, 0.9, 1.5, 0.7, 1.3, 0.8, 1.1, 1.4, 1.0)
STEP_S = 4.0
ROUND_TRIPS_MS = 100, 300, 1000, 2000
CONNECTIONS = 1, 2, 4, 8
SECONDS = 40.0
# Steps before this many round trips, and this time, are part of the start.
START_S, START_ROUND_TRIPS = 8.0, 12
POLL_MS, ENDS_WITHIN_S = 50, 60.0
Floats = NDArray[np.float64]


class Followed(NamedTuple):
    """One run: its steps, those followed, the share of judged time within the bar, the account.

    errors: largest error after each step, as a share of the press.
    """

    errors: list[float]
    within: float
    display: Summary


def main() -> None:
    """Print the table. Bar: within 5 % of the press from 0.3 s and a round trip after a step on."""
    reason = unavailable()
    if reason is not None:
        print(f"press_paths: left out: {reason}")
        return
    control = Path("/proc/sys/net/ipv4/tcp_congestion_control").read_text(encoding="ascii").strip()
    cases = list(product(ROUND_TRIPS_MS, CONNECTIONS))
    with ThreadPoolExecutor(2) as pool:
        runs = list(pool.map(lambda case: follow(*case), cases))
    show(
        f"Press over TCP ({control}) with 1 % loss and 10 % of jitter, {SECONDS:g} s each",
        ("round trip (ms)", "connections", "followed", "within", "sent", "applied", "superseded",
         "lost"),
        [row(*case, run) for case, run in zip(cases, runs, strict=True)],
    )


def row(round_trip_ms: int, connections: int, run: Followed) -> tuple[str, ...]:
    """Return the row of a run."""
    met = sum(error <= FOLLOW_ERROR for error in run.errors)
    press = run.display.press
    counts = press.sent, press.applied, press.superseded, press.lost
    return (
        str(round_trip_ms),
        str(connections),
        f"{met} of {len(run.errors)}",
        f"{run.within:.1%}",
        *map(str, counts),
    )


def follow(round_trip_ms: int, connections: int, loss: str = "1%") -> Followed:
    """Run both nodes, and score the steps."""
    delay_ms = round_trip_ms / 2
    link = parse_link(f"delay={delay_ms:g}ms,jitter={delay_ms / 10:g}ms,loss={loss}")
    with TemporaryDirectory(prefix="telepulse-") as folder:
        scene = Path(folder, "press.toml")
        text = find_scene("press").read_text(encoding="utf-8")
        text = text.replace('extends = "radial"', f'extends = "{find_scene("radial")}"')
        levels = ", ".join(f'"{each} N"' for each in LEVELS_N)
        text = text.replace('levels = ["0.7 N", "1.2 N", "0.9 N", "1.3 N"]', f"levels = [{levels}]\nstiffness = \"0 N/m\"")
        text = text.replace("[display.press]\n", f"[display.press]\nconnections = {connections}\n")
        scene.write_text(text, encoding="utf-8")
        with emulate(link, seed=round_trip_ms + connections) as emulated:
            return play(Path(folder), scene, emulated, round_trip_ms * 1e-3)


def play(folder: Path, scene: Path, emulated: EmulatedLink, round_trip_s: float) -> Followed:
    """Run both nodes over a link."""
    common = (str(scene), "--quiet", "--insecure", "--seconds")
    telemetry = f"ipc://{folder}/telemetry"
    at_s: list[float] = []
    ticks_ns: list[int] = []
    times_ns: list[NDArray[np.int64]] = []
    forces_n: list[Floats] = []

    def ticked(parts: list[bytes]) -> None:
        if parts[0] == TRACE:
            ticks_ns.append(int(read_trace(parts[1])[0].now_ns[-1]))

    def sensed(parts: list[bytes]) -> None:
        frame = decode_frame(parts[0])
        count = len(frame.values)
        times_ns.append(frame.t_first_ns + frame.period_ns * np.arange(count))
        forces_n.append(frame.values[:, 1] - frame.values[:, 0])

    with emulated.display.entered():
        display = NodeProcess(
            *("display node", "display_node.cli", *common, str(SECONDS + ENDS_WITHIN_S)),
            *("--connect", f"tcp://{emulated.sensing.address}:{PORT}", "--once"),
            *("--telemetry", telemetry),
            summary=folder / "display.json",
            stderr=PIPE,
        )
    with display, tap(telemetry, ticked):
        time.sleep(1.0)
        with emulated.sensing.entered():
            sensing = NodeProcess(
                *("sensing node", "sensing_node.cli", *common, str(SECONDS)),
                *("--bind", f"tcp://*:{PORT}"),
                summary=folder / "sensing.json",
                stderr=PIPE,
            )
        with sensing:
            with emulated.sensing.entered():
                tapped = tap(f"tcp://127.0.0.1:{PORT}", sensed)
                tapped.__enter__()
            sensing.await_summary(SECONDS + ENDS_WITHIN_S)
            summary = display.await_summary(ENDS_WITHIN_S)
            time.sleep(0.2)
            tapped.__exit__(None, None, None)
    # The first tick.
    begun_ns = ticks_ns[-1] - round(summary.availability.seconds * 1e9)
    return score(np.concatenate(times_ns) - begun_ns, np.concatenate(forces_n), round_trip_s, summary)


def score(times_ns, forces_n, round_trip_s, summary) -> Followed:
    errors, within = [], []
    wait_s = FOLLOWED_S + round_trip_s
    first = math.ceil((START_S + START_ROUND_TRIPS * round_trip_s) / STEP_S)
    # The finger sends nothing after the end of the stream.
    for number in range(first, int(times_ns[-1] * 1e-9 / STEP_S)):
        level_n = LEVELS_N[number % len(LEVELS_N)]
        begin_ns, end_ns = ((number * STEP_S + wait_s) * 1e9, (number + 1) * STEP_S * 1e9)
        judged = forces_n[(times_ns >= begin_ns) & (times_ns < end_ns)]
        error = np.abs(judged / level_n - 1)
        errors.append(float(error.max()))
        within.append(float((error <= FOLLOW_ERROR).mean()))
    return Followed(errors, float(np.mean(within)), summary)


@contextmanager
def tap(address, take) -> Iterator[None]:
    """Give `take` the parts of each message published at an address."""
    over = threading.Event()
    context = zmq.Context()
    socket = context.socket(zmq.SUB)
    socket.subscribe(b"")
    socket.connect(address)

    def run() -> None:
        while not over.is_set():
            if socket.poll(POLL_MS):
                take(socket.recv_multipart())

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        context.destroy(linger=0)


if __name__ == "__main__":
    for case in sys.argv[1:]:
        trip, count = map(int, case.split(","))
        run = follow(trip, count)
        print(*row(trip, count, run), [f"{e:.3f}" for e in run.errors], run.display.data_connections, run.display.reconnections, run.display.playout_delay_ms, run.display.clock, run.display.availability, run.display.rejected, sep="\n  ", flush=True)
