"""Cost of the core: prediction, simulation, live tick, frame, latency, sweep and memory.

`python -m benchmarks.core work|simulate|tick|frame|latency|sweep|memory` runs one part, and prints
its figures as JSON; the last two take minutes, and run once.
"""

import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import msgpack
import numpy as np

from benchmarks.benchmark import Benchmark
from benchmarks.criteria import CRITERIA
from benchmarks.peers import BARE, BARE_CURVE, OURS, OURS_CURVE
from display_node.display import Display
from display_node.prediction.ensemble import Ensemble
from display_node.prediction.scene import own_predictor
from display_node.reception.link_delay import LATE_TARGET
from display_node.reception.receiver import Receiver
from protocol.config.scene_file import find_scene
from protocol.wire import messages
from telepulse.scene import load_scene
from telepulse.simulation.virtual_time import Simulation
from tests.support.node_rig import rss_bytes
from tests.support.nodes import ROOT, run_python
from tests.support.sender import MS, Sender
from tests.support.streams import description

ROUNDS = 3
SECONDS = 20.0
TICK_SECONDS = "20"
# Memory is watched once the predictors have learnt and all buffers are full.
MEMORY_SECONDS, MEMORY_FROM_S, MEMORY_EVERY_S = 1_200.0, 120.0, 5.0
SWEEP = """
import functools, time, telepulse
run, times_s = functools.partial(telepulse.simulate, "radial", 60.0), [time.monotonic()]
for every in (map, telepulse.sweep):
    list(every(run, range(16)))
    times_s.append(time.monotonic())
print((times_s[1] - times_s[0]) / (times_s[2] - times_s[1]))
"""
MESSAGES = 2_000
FRAMES = 1_000
PAUSE_S = 500e-6
LINK = "delay=40ms,jitter=10ms,loss=1%"


def work() -> dict[str, float]:
    """Return the time of the predictor's work in a tick of `radial` in virtual time, in µs."""
    spent_ns, plain = [0], Ensemble.work

    def timed(ensemble: Ensemble) -> bool:
        began_ns = time.perf_counter_ns()
        worked = plain(ensemble)
        spent_ns[0] += time.perf_counter_ns() - began_ns
        return worked

    with patch.object(Ensemble, "work", timed):
        simulation = Simulation(load_scene(find_scene("radial")), seed=1)
        ticks = simulation.run(SECONDS).loop.ticks
    return {"work of the stack in µs a tick": spent_ns[0] * 1e-3 / (ticks or 1)}


def simulate() -> dict[str, float]:
    """Return the simulated time over the processor time of `radial`, without and with learning."""
    radial, speeds = load_scene(find_scene("radial")), {}
    for predictor in ("linear", "stack"):
        display = radial.display.model_copy(update={"predictor": own_predictor(predictor)})
        simulation = Simulation(replace(radial, display=display), seed=1)
        began_s = time.process_time()
        simulation.run(SECONDS)
        speeds[f"simulate radial, {predictor}"] = SECONDS / (time.process_time() - began_s)
    return speeds


def tick() -> dict[str, float]:
    """Return quantiles of the time of a live tick with the stack, and to its command, in µs."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "summary.json"
        words = ("demo", "--seconds", TICK_SECONDS, "--no-ui", "--link", LINK, "--json", str(path))
        ended = run_python("-m", "telepulse", *words, cwd=Path.cwd(), timeout=120)
        assert ended.returncode == 0, ended.stderr
        loop = json.loads(path.read_text(encoding="utf-8"))["loop"]
    return {
        f"live {part}, {name} in µs": loop[key][name]
        for part, key in (("tick", "tick_us"), ("wake-up to command", "command_us"))
        for name in ("p50", "p99")
    }


def frame() -> dict[str, float]:
    """Return p50 in µs of what a frame of one sample costs a process that has slept before.

    Each step is measured with another frame, since caches are warm after the first one.
    """
    sender = Sender(stream=description(batch=1))
    receiver = Receiver("frame", [0], LATE_TARGET)
    sender.serve(receiver, 0, until_ms=101)
    values = np.full((1, 1), 0.3, np.float32)

    def frame_at(now_ns: int) -> messages.Frame:
        return messages.Frame(1, 2, now_ns, MS, values)

    steps: dict[str, Callable[[bytes, int], object]] = {
        "nothing": lambda data, now_ns: None,
        "encode_frame": lambda data, now_ns: messages.encode_frame(frame_at(now_ns)),
        "msgpack alone": lambda data, now_ns: msgpack.unpackb(data),
        "decode_flat_frame": lambda data, now_ns: messages.decode_flat_frame(data),
        "Receiver.on_frame": receiver.on_frame,
    }
    spent_ns: dict[str, list[int]] = {name: [] for name in steps}
    for number in range(FRAMES):
        for at, (name, step) in enumerate(steps.items()):
            now_ns = (101 + number * len(steps) + at) * MS
            data = sender.frame(now_ns, 0.3, count=1)
            time.sleep(PAUSE_S)
            began_ns = time.perf_counter_ns()
            step(data, now_ns)
            spent_ns[name].append(time.perf_counter_ns() - began_ns)
    assert not receiver.rejected, receiver.rejected
    return {f"frame: {name} in µs": float(np.median(ns)) * 1e-3 for name, ns in spent_ns.items()}


def latency() -> dict[str, float]:
    """Return p50 of the time until a frame is done, over that of pyzmq until it is decoded."""
    figures = {}
    for name, ours, bare in (("", OURS, BARE), (", CURVE", OURS_CURVE, BARE_CURVE)):
        runs = [peer.run(MESSAGES) for peer in (bare, ours)]
        base_us, usable_us = (float(np.median(each.delays_ns)) * 1e-3 for each in runs)
        figures[f"pyzmq in µs{name}"] = base_us
        figures[f"latency over pyzmq{name}"] = usable_us / base_us
        figures[f"done over pyzmq{name}"] = float(np.median(runs[1].done_ns)) * 1e-3 / base_us
    return figures


def sweep() -> dict[str, float]:
    """Return the time of 16 seeds one after the other over that of a sweep on all cores."""
    ended = run_python("-c", SWEEP, cwd=Path.cwd(), timeout=600)
    assert ended.returncode == 0, ended.stderr
    return {"16 seeds of 60 s in turn over a sweep": float(ended.stdout)}


def memory() -> dict[str, float]:
    """Return the growth of the memory of both nodes at 5 kHz, in MB in an hour of the stream."""
    scene = load_scene(find_scene("radial"), sensing={"source": {"rate": "5 kHz"}})
    simulation, used = Simulation(scene, seed=1), [(0.0, 0)]

    def watch(now_s: float) -> None:
        if now_s >= used[-1][0] + MEMORY_EVERY_S:
            used.append((now_s, rss_bytes(os.getpid())))

    # With the running errors too, which a display on real sockets computes.
    display = Display(scene.display, "simulated display")
    display.take_ticks, simulation.display = simulation.display.take_ticks, display
    simulation.run(MEMORY_SECONDS, progress=watch)
    times_s, late_bytes = np.array([row for row in used if row[0] >= MEMORY_FROM_S]).T
    return {"growth of memory in MB/h": float(np.polyfit(times_s, late_bytes, 1)[0]) * 3600e-6}


IN_TURNS, ONCE = (work, simulate, tick, frame, latency), (sweep, memory)
PARTS = {part.__name__: part for part in (*IN_TURNS, *ONCE)}


def main(benchmark: Benchmark) -> None:
    """Run each part in processes of its own, in turns, and print the medians."""
    found: dict[str, list[float]] = {}
    for turn in range(1 if benchmark.quick else ROUNDS):
        for part in PARTS.values() if turn == 0 and not benchmark.quick else IN_TURNS:
            ended = run_python("-m", "benchmarks.core", part.__name__, cwd=ROOT, timeout=1_200)
            assert ended.returncode == 0, ended.stderr
            for key, value in json.loads(ended.stdout).items():
                found.setdefault(key, []).append(value)
    medians = {key: statistics.median(values) for key, values in found.items()}
    benchmark.table(
        f"The core, medians of {ROUNDS} rounds",
        ("figure", "median"),
        [(key, f"{value:.3g}") for key, value in medians.items()],
    )
    for criterion in CRITERIA[benchmark.name]:
        if criterion.name in medians:
            benchmark.judge(criterion.name, medians[criterion.name])


if __name__ == "__main__":
    print(json.dumps(PARTS[sys.argv[1]]()))
