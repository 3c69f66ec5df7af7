"""An emulated drive and film, whose display a soak stalls or cuts off at random."""

import signal
import subprocess
import time
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import zmq

from protocol.host.child_process import ChildProcess
from protocol.wire.telemetry import STATUS, read_status
from soak.bench_truth import FingerClaim, Round
from soak.schedule import BENCH_WATCHDOG_S, Trouble, troubles
from tests.support.emulated_bench import BenchFailedError, EmulatedBench, playing

# Longer than the scene's, so that a busy machine does not end each round by a fault.
WATCHDOG_MS = round(BENCH_WATCHDOG_S * 1e3)
# Time until the tip is off the finger, and several statuses have reported it.
AFTER_S = 3.0
POLL_MS = 50


def play_rounds(
    folder: Path, seed: int, count: int, log: Callable[[str], None]
) -> tuple[list[Round], list[str]]:
    """Play rounds of one trouble each; return them, and the reasons of failed ones."""
    rounds, failures = list[Round](), list[str]()
    for number, trouble in enumerate(islice(troubles(seed), count)):
        (here := folder / f"bench-{number}").mkdir()
        log(f"bench {number + 1} of {count}: {trouble}")
        try:
            rounds.append(_play(here, trouble))
        except (BenchFailedError, subprocess.TimeoutExpired) as error:
            failures.append(str(error))
    return rounds, failures


def _play(folder: Path, trouble: Trouble) -> Round:
    """Play until the pulse is felt, make the trouble, and end the display by SIGTERM."""
    claims = list[FingerClaim]()
    with playing(folder, "tmcl", watchdog_ms=WATCHDOG_MS) as bench:
        with zmq.Context() as context, context.socket(zmq.SUB) as socket:
            socket.connect(bench.telemetry)
            socket.subscribe(STATUS)
            claims += _listen(socket, trouble.after_s)
            _make(trouble, bench)
            claims += _listen(socket, AFTER_S)
            display = bench.processes["display"]
            display.send_signal(signal.SIGTERM)
            claims += _listen(socket, AFTER_S, display)
        summary = bench.end()
        motor = bench.motor()
        status = display.returncode
    faults, finger = summary.get("faults", []), summary.get("finger") or ""
    return Round(str(trouble), claims, status, faults, finger, motor.time_ns, motor.force_n)


def _make(trouble: Trouble, bench: EmulatedBench) -> None:
    """Stall the display, or kill the sensing node."""
    if trouble.kind == "cut":
        bench.processes["sensing"].kill()
        return
    display = bench.processes["display"]
    display.send_signal(signal.SIGSTOP)
    time.sleep(trouble.for_s)
    display.send_signal(signal.SIGCONT)


def _listen(
    socket: "zmq.Socket[bytes]",
    seconds: float,
    until_ended: ChildProcess | None = None,
) -> list[FingerClaim]:
    """Return the statuses of some seconds, or until a process ends."""
    found, until_s = list[FingerClaim](), time.monotonic() + seconds
    while time.monotonic() < until_s:
        if until_ended is not None and until_ended.poll() is not None:
            until_s = 0.0  # the statuses it has sent are still read
        while socket.poll(POLL_MS):
            _, data = socket.recv_multipart()
            status = read_status(data)
            finger = status.summary["finger"] or ""
            found.append(FingerClaim(time.perf_counter_ns(), status.state, finger))
            if time.monotonic() > until_s > 0:
                break
    return found
