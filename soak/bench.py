"""An emulated drive and film, whose display a soak stalls or cuts off at random."""

import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from random import Random

import zmq

from benchmarks.whole_bench import BenchFailedError, WholeBench, playing
from display_node.telemetry import STATUS, read_status
from soak.bench_truth import FingerClaim, Round

# Of stalls, evenly by their logarithm: around the drive's watchdog, and far beyond it.
STALLS_S = (0.05, 5.0)
# So patient are watchdog and film, so that a machine that is busy does not end each round.
PATIENCE_MS = 200
PLAYED_S = (0.5, 2.0)
# Until a tip that is withdrawn is off, and is named so several times.
AFTER_S = 3.0
POLL_MS = 50


def play_rounds(
    folder: Path, seed: int, count: int, log: Callable[[str], None]
) -> tuple[list[Round], list[str]]:
    """Play rounds of one trouble each; return them, and why others could not be played."""
    random = Random(seed)
    rounds, failures = list[Round](), list[str]()
    for number in range(count):
        (here := folder / f"bench-{number}").mkdir()
        log(f"bench {number + 1} of {count}")
        try:
            rounds.append(_play(here, random))
        except (BenchFailedError, subprocess.TimeoutExpired) as error:
            failures.append(str(error))
    return rounds, failures


def _play(folder: Path, random: Random) -> Round:
    """Play until the pulse is felt, make the trouble, and end the display by SIGTERM."""
    claims = list[FingerClaim]()
    with playing(folder, "tmcl", patience_ms=PATIENCE_MS) as bench:
        with zmq.Context() as context, context.socket(zmq.SUB) as socket:
            socket.connect(bench.telemetry)
            socket.subscribe(STATUS)
            claims += _listen(socket, random.uniform(*PLAYED_S))
            trouble = _trouble(bench, random)
            claims += _listen(socket, AFTER_S)
            display = bench.processes["display"]
            display.send_signal(signal.SIGTERM)
            claims += _listen(socket, AFTER_S, display)
        summary = bench.end()
        motor = bench.motor()
        status = display.returncode
    faults, finger = summary.get("faults", []), summary.get("finger") or ""
    return Round(trouble, claims, status, faults, finger, motor.time_ns, motor.force_n)


def _trouble(bench: WholeBench, random: Random) -> str:
    """Stall the display, or kill the sensing node; return what was done."""
    if random.random() < 0.25:
        bench.processes["sensing"].kill()
        return "cut"
    low_s, high_s = STALLS_S
    seconds = low_s * (high_s / low_s) ** random.random()
    display = bench.processes["display"]
    display.send_signal(signal.SIGSTOP)
    time.sleep(seconds)
    display.send_signal(signal.SIGCONT)
    return f"stall {seconds:.2f} s"


def _listen(
    socket: "zmq.Socket[bytes]",
    seconds: float,
    until_ended: "subprocess.Popen[bytes] | None" = None,
) -> list[FingerClaim]:
    """Return the statuses of a while, or of less where a process ends meanwhile."""
    found, until_s = list[FingerClaim](), time.monotonic() + seconds
    while time.monotonic() < until_s:
        if until_ended is not None and until_ended.poll() is not None:
            until_s = 0.0  # what it sent is still to be read
        while socket.poll(POLL_MS):
            _, data = socket.recv_multipart()
            status = read_status(data)
            finger = status.summary["finger"] or ""
            found.append(FingerClaim(time.monotonic_ns(), status.state, finger))
            if time.monotonic() > until_s > 0:
                break
    return found
