"""The press over real TCP that loses packets: steps followed, by round trip and connections.

Both real nodes, in network namespaces with an emulated link between them. The modelled finger steps
every 4 s; scored is the hold-down that leaves the sensing node against what the finger means. Needs
root, for the link emulator.
"""

import math
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from subprocess import PIPE
from tempfile import TemporaryDirectory
from typing import NamedTuple, Self

import numpy as np
import zmq
from numpy.typing import NDArray

from benchmarks.benchmark import Benchmark
from protocol.config.scene_file import find_scene
from protocol.summary.tables import Summary
from protocol.wire.messages import decode_frame
from protocol.wire.telemetry import TRACE, read_trace
from telepulse.processes import NodeProcess
from telepulse.simulation.link_scene import parse_link
from tests.support.netem import EmulatedLink, emulate, unavailable
from tests.support.netem.emulated_link import PORT
from tests.support.press_runs import FOLLOW_ERROR, FOLLOWED_S, LEVELS_N, STEP_S

SECONDS = 70.0
# Steps before this time, and so many round trips, are those of the start.
START_S, START_ROUND_TRIPS = 8.0, 12
ENDS_WITHIN_S = 60.0
POLL_MS = 50
CONGESTION_CONTROL = Path("/proc/sys/net/ipv4/tcp_congestion_control")
SCENE = """\
extends = "{press}"

[sensing]
batch = "{batch}"

[display]
paths = {paths}

[display.press]
connections = {connections}

[display.press.sensor]
levels = [{levels}]
stiffness = "0 N/m"
"""


class Case(NamedTuple):
    """A run: round trip, connections of the set-points, duration of a frame, data connections."""

    round_trip_ms: int
    connections: int
    batch: str = "5 ms"
    paths: int = 3


LONG_FRAMES = {1000: ("50 ms", 8), 2000: ("50 ms", 8)}
CASES = (
    *(Case(100, count) for count in (0, 16)),
    *(Case(300, count) for count in (0, 2, 4, 16)),
    Case(1000, 16),
    *(Case(trip, count, *rest) for trip, rest in LONG_FRAMES.items() for count in (0, 4, 8, 16)),
)


class Followed(NamedTuple):
    """One run: largest error after each step and share of the time within the bar, and summary."""

    errors: list[float]
    within: float
    display: Summary


def main(benchmark: Benchmark) -> None:
    """Print the table. Bar: within 5 % of the press from 0.3 s and a round trip after a step on."""
    reason = unavailable()
    if reason is not None:
        print(f"press_paths: left out: {reason}")
        return
    with ThreadPoolExecutor(2) as pool:
        rows = list(pool.map(lambda case: row(case, follow(case)), CASES))
    control = CONGESTION_CONTROL.read_text(encoding="ascii").strip()
    benchmark.table(
        f"Press over TCP ({control}), 1 % loss and 10 % of jitter, {SECONDS:g} s each: steps after"
        f" which the hold-down is within {FOLLOW_ERROR:.0%}, and the share of the judged time",
        ("round trip", "connections", "frames", "paths", "steps followed", "within", "blind",
         "sent", "applied", "superseded", "lost"),
        rows,
    )  # fmt: skip


def row(case: Case, run: Followed) -> tuple[str, ...]:
    """Return the row of a run."""
    met = sum(error <= FOLLOW_ERROR for error in run.errors)
    press, stale = run.display.press, run.display.availability.stale
    return (
        f"{case.round_trip_ms} ms",
        str(case.connections or 1),
        case.batch,
        str(case.paths),
        f"{met} of {len(run.errors)}",
        f"{run.within:.1%}",
        f"{stale or 0.0:.1%}",
        *map(str, (press.sent, press.applied, press.superseded, press.lost)),
    )


def follow(case: Case) -> Followed:
    """Run both nodes, and score the steps."""
    delay_ms = case.round_trip_ms / 2
    link = parse_link(f"delay={delay_ms:g}ms,jitter={delay_ms / 10:g}ms,loss=1%")
    with TemporaryDirectory(prefix="telepulse-") as folder:
        scene = Path(folder, "press.toml")
        levels = ", ".join(f'"{level_n} N"' for level_n in LEVELS_N)
        settings = {"press": find_scene("press"), "levels": levels} | case._asdict()
        scene.write_text(SCENE.format(**settings), encoding="utf-8")
        with emulate(link, seed=case.round_trip_ms + case.connections) as emulated:
            return play(scene, emulated, case.round_trip_ms * 1e-3)


def play(scene: Path, emulated: EmulatedLink, round_trip_s: float) -> Followed:
    """Run both nodes over a link; take the ticks of the display, and the frames as they leave."""
    folder, common = scene.parent, (str(scene), "--quiet", "--insecure", "--seconds")
    telemetry = f"ipc://{folder}/telemetry"
    ticks_ns: list[int] = []
    times_ns: list[NDArray[np.int64]] = []
    forces_n: list[NDArray[np.float64]] = []

    def take_ticks(parts: list[bytes]) -> None:
        if parts[0] == TRACE:
            ticks_ns.append(int(read_trace(parts[1])[0].now_ns[-1]))

    def take_frame(parts: list[bytes]) -> None:
        frame = decode_frame(parts[0])
        times_ns.append(frame.t_first_ns + frame.period_ns * np.arange(len(frame.values)))
        forces_n.append(frame.values[:, 1] - frame.values[:, 0])

    with emulated.display.entered():
        display = NodeProcess(
            *("display node", "display_node.cli", *common, str(SECONDS + ENDS_WITHIN_S)),
            *("--connect", f"tcp://{emulated.sensing.address}:{PORT}", "--once"),
            *("--telemetry", telemetry),
            summary=folder / "display.json",
            stderr=PIPE,
        )
    with display, Tap(telemetry, take_ticks):
        with emulated.sensing.entered():
            sensing = NodeProcess(
                *("sensing node", "sensing_node.cli", *common, str(SECONDS)),
                *("--bind", f"tcp://*:{PORT}"),
                summary=folder / "sensing.json",
                stderr=PIPE,
            )
            frames = Tap(f"tcp://127.0.0.1:{PORT}", take_frame)
        with sensing, frames:
            sensing.await_summary(SECONDS + ENDS_WITHIN_S)
            summary = display.await_summary(ENDS_WITHIN_S)
    # The finger's first step is at the display's first tick.
    began_ns = ticks_ns[-1] - round((summary.availability.seconds or 0.0) * 1e9)
    errors, within = score(
        np.concatenate(times_ns) - began_ns, np.concatenate(forces_n), round_trip_s
    )
    return Followed(errors, within, summary)


def score(
    times_ns: NDArray[np.int64], forces_n: NDArray[np.float64], round_trip_s: float
) -> tuple[list[float], float]:
    """Score the hold-down at times since the finger's first step, as in `Followed`."""
    errors, within = list[float](), list[float]()
    first = math.ceil((START_S + START_ROUND_TRIPS * round_trip_s) / STEP_S)
    for number in range(first, int(times_ns[-1] * 1e-9 / STEP_S)):
        begin_ns = (number * STEP_S + FOLLOWED_S + round_trip_s) * 1e9
        judged = (times_ns >= begin_ns) & (times_ns < (number + 1) * STEP_S * 1e9)
        error = np.abs(forces_n[judged] / LEVELS_N[number % len(LEVELS_N)] - 1)
        errors.append(float(error.max()))
        within.append(float((error <= FOLLOW_ERROR).mean()))
    return errors, float(np.mean(within))


class Tap:
    """A reader of what is published at an address, in the network namespace of its making.

    take: is given the parts of each message, in another thread.
    """

    def __init__(self, address: str, take: Callable[[list[bytes]], None]) -> None:
        self._context, self._take = zmq.Context[zmq.Socket[bytes]](), take
        self._socket = self._context.socket(zmq.SUB)
        self._socket.subscribe(b"")
        self._socket.connect(address)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._context.destroy(linger=0)

    def _run(self) -> None:
        while not self._over.is_set():
            if self._socket.poll(POLL_MS):
                self._take(self._socket.recv_multipart())
