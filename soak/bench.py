"""An emulated drive and film, whose display a soak stalls or cuts off at random."""

import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from pathlib import Path

from protocol.faults import faults_of
from protocol.finger import finger_in
from soak.bench_truth import FingerClaim, Round
from soak.schedule import BENCH_WATCHDOG_S, Trouble, troubles
from tests.support.emulated_bench import BenchFailedError, EmulatedBench, playing
from tests.support.felt_force import recording

# Longer than the scene's, so that a busy machine does not end each round by a fault.
WATCHDOG_MS = round(BENCH_WATCHDOG_S * 1e3)
# Time until the tip is off the finger, and several statuses have reported it.
AFTER_S = 3.0
# Time until the last statuses are read.
READ_WITHIN_S = 0.2


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
    with playing(folder, "tmcl", watchdog_ms=WATCHDOG_MS) as bench:
        display = bench.processes["display"]
        with recording(bench.telemetry) as felt:
            time.sleep(trouble.after_s)
            _make(trouble, bench)
            time.sleep(AFTER_S)
            display.terminate()
            with suppress(subprocess.TimeoutExpired):
                display.wait(AFTER_S)
            time.sleep(READ_WITHIN_S)
        summary = bench.end()
        motor = bench.motor()
    claims = [
        FingerClaim(read_ns, status.state, finger_in(status.summary))
        for read_ns, status in felt.statuses
    ]
    faults, finger = faults_of(summary), finger_in(summary)
    return Round(
        str(trouble), claims, display.returncode, faults, finger, motor.time_ns, motor.force_n
    )


def _make(trouble: Trouble, bench: EmulatedBench) -> None:
    """Stall the display, or kill the sensing node."""
    if trouble.kind == "cut":
        bench.processes["sensing"].kill()
    else:
        bench.stall("display", trouble.for_s)
