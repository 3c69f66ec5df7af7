"""Faults on the whole emulated bench: time until the tip rests or presses no more.

The time ends when the tip stays at rest or stays almost off the finger, whichever is first. It is
read from the emulated motor's own record, on the clock by which the fault is made.
"""

import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.benchmark import Benchmark
from tests.support.emulated_bench import KINDS, BenchFailedError, EmulatedBench, MotorTrace, playing

REPEATS = 2
TRIES = 3
AFTER_S = 1.0
# Time from first contact to a fault of the emulator: by then the pulse is felt.
TROUBLE_AFTER_S = 2.0
# Stops of the display's process: shorter than, and far beyond, what the drive's watchdog allows.
STOPS_S = (0.1, 0.3, 2.0)
STOPPED_S = 0.3
STILL_M_PER_S = 1e-6
# At 0 N the tip is held where it just touches, to a few microsteps of 0.6 mN.
LIGHT_N = 0.01
# Slopes are taken over this time, which is longer than single microsteps.
STRETCH_MS = 10


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a fault: ms until the tip rests or is off, and the fault's names in the summary."""

    peace_ms: float
    named: tuple[str, ...]


def main(benchmark: Benchmark) -> None:
    """Print the tables: faults, restarts, and stops of the display's process."""
    kinds = ("TMCL, ms", "CiA 402, ms")
    benchmark.table(
        f"From a fault until the tip rests or is off, most of {REPEATS}",
        ("fault", "what is done", *kinds, "named"),
        faults := [row(*fault) for fault in FAULTS],
    )
    benchmark.table(
        "Felt after a restart",
        ("restart", "drive", "most N", "fastest N/s", "rise ms"),
        restarts := [
            restart_row(kind, name, happens) for name, happens in RESTARTS for kind in KINDS
        ],
    )
    # A display that is stopped cannot act, so only its drive's watchdog counts then.
    faults = [each for each in faults if not each[0].startswith("the display stands still")]
    times_ms = [
        float(cell) for _, _, *cells, _ in faults for cell in cells if cell not in ("none", "–")
    ]
    benchmark.judge("time from a fault until the tip rests or is off", 1e-3 * max(times_ms))
    felt = [each for each in restarts if each[2]]
    benchmark.judge("force after a restart", max(float(each[2]) for each in felt))
    benchmark.judge("slew after a restart", max(float(each[3]) for each in felt))


def row(
    name: str, done: str, once: Callable[[str, Path], Outcome], kinds: Sequence[str] = KINDS
) -> tuple[str, ...]:
    """Return the row of a fault; kinds: of the drives that can have it."""
    outcomes: list[Outcome] = []
    times_ms = []
    for kind in KINDS:
        if kind not in kinds:
            times_ms.append("–")
            continue
        some = [tried(partial(once, kind)) for _ in range(REPEATS)]
        found = [outcome for outcome in some if outcome is not None]
        times_ms.append(f"{max(outcome.peace_ms for outcome in found):.0f}" if found else "none")
        outcomes += found
    named = sorted(
        {": ".join(fault.split(": ")[:2]) for outcome in outcomes for fault in outcome.named}
    )
    return name, done, *times_ms, ", ".join(named)


def tried(once: Callable[[Path], Outcome]) -> Outcome | None:
    """Return the result of a fault on a bench that played until then.

    None if on a busy machine every attempt failed before the fault.
    """
    for _ in range(TRIES):
        with TemporaryDirectory(prefix="telepulse-") as folder:
            try:
                return once(Path(folder))
            except BenchFailedError as error:
                print(f"once more: {str(error).splitlines()[0]}")
    return None


def kill_one(
    name: str, signal_number: int, kind: str, folder: Path, stopped_s: float = STOPPED_S
) -> Outcome:
    """Send a process of the bench a signal; a stopped one continues after a while."""
    with playing(folder, kind) as bench:
        at_ns = time.perf_counter_ns()
        bench.processes[name].send_signal(signal_number)
        if signal_number == signal.SIGSTOP:
            time.sleep(stopped_s)
            bench.processes[name].send_signal(signal.SIGCONT)
        time.sleep(AFTER_S)
        return ended(bench, at_ns)


def trouble(word: str, kind: str, folder: Path) -> Outcome:
    """Inject a fault into the drive's emulator."""
    options = ("--fault", word, "--fault-after", f"{TROUBLE_AFTER_S:g}")
    with playing(folder, kind, "real_bench", *options) as bench:
        bench.await_state("fault")
        time.sleep(AFTER_S)
        return ended(bench, None)


def ended(bench: EmulatedBench, at_ns: int | None) -> Outcome:
    """Stop the bench, and return the result from the motor's record since a fault.

    at_ns: time of the fault; None: as the emulator recorded it.
    """
    last_ns = time.perf_counter_ns()
    summary = bench.end()
    motor = bench.motor()
    at_ns = at_ns or motor.trouble_ns
    if at_ns is None or not pressed(motor, at_ns):
        raise BenchFailedError(f"no pulse when the fault came: {summary.get('faults')}")
    # Up to the end of the display, which also moves the tip.
    seen = (motor.time_ns >= at_ns) & (motor.time_ns < last_ns)
    moves = seen & (np.abs(motor.speed_m_per_s) > STILL_M_PER_S)
    presses = seen & (motor.force_n > LIGHT_N)
    peace_ns = min(int(motor.time_ns[here].max(initial=at_ns)) for here in (moves, presses))
    return Outcome((peace_ns - at_ns) / 1e6, tuple(summary.get("faults", ())))


def pressed(motor: MotorTrace, at_ns: int) -> bool:
    """Return whether the pulse was felt in the 100 ms before a time."""
    before = (motor.time_ns < at_ns) & (motor.time_ns > at_ns - 100_000_000)
    return bool(before.any() and motor.force_n[before].min() > 0.05)


def restart_row(
    kind: str, name: str, happens: Callable[[Path, str], MotorTrace]
) -> tuple[str, ...]:
    """Return force, slew and rise at the finger after a restart."""
    for _ in range(TRIES):
        with TemporaryDirectory(prefix="telepulse-") as folder:
            try:
                motor = happens(Path(folder), kind)
            except BenchFailedError as error:
                print(f"once more: {str(error).splitlines()[0]}")
                continue
        felt_n = motor.force_n
        slope = (felt_n[STRETCH_MS:] - felt_n[:-STRETCH_MS]) / STRETCH_MS * 1e3
        return name, kind, f"{felt_n.max():.3f}", f"{slope.max():.1f}", rise_ms(felt_n)
    return name, kind, "", "", f"failed {TRIES} times"


def sensing_restarted(folder: Path, kind: str) -> MotorTrace:
    """Kill and restart the sensing node, and return the record from then on."""
    with playing(folder, kind) as bench:
        bench.processes["sensing"].kill()
        bench.await_state("stale")
        time.sleep(AFTER_S)
        return felt_again(bench, bench.start_sensing)


def display_restarted(folder: Path, kind: str) -> MotorTrace:
    """Stop the display until the drive's watchdog acts, restart it, and return the record since."""
    with playing(folder, kind) as bench:
        display = bench.processes["display"]
        display.send_signal(signal.SIGSTOP)
        time.sleep(STOPPED_S)
        display.send_signal(signal.SIGCONT)
        bench.await_state("fault")
        display.terminate()
        display.wait()
        return felt_again(bench, bench.start_display)


def felt_again(bench: EmulatedBench, start: Callable[[], None]) -> MotorTrace:
    """Start a missing node, and return the record since. Raises BenchFailedError for a fault."""
    began_ns = time.perf_counter_ns()
    start()
    bench.await_state("playing")
    time.sleep(AFTER_S)
    summary = bench.end()
    if summary["faults"]:
        raise BenchFailedError(f"at fault: {summary['faults']}")
    motor = bench.motor()
    later = motor.time_ns >= began_ns
    return MotorTrace(
        motor.time_ns[later], motor.speed_m_per_s[later], motor.force_n[later], motor.trouble_ns
    )


def rise_ms(felt_n: "np.typing.NDArray[np.float64]") -> str:
    """Return the time in ms of the first rise from 10 % to 90 % of the usual force."""
    usual_n = np.median(felt_n[felt_n > LIGHT_N])
    first, then = np.argmax(felt_n > 0.1 * usual_n), np.argmax(felt_n > 0.9 * usual_n)
    return f"{then - first}"


FAULTS: tuple[tuple[Any, ...], ...] = (
    ("the film falls silent", "the tip leaves the finger", partial(trouble, "film-silent")),
    (
        "the sensing node is killed",
        "the force fades to 0",
        partial(kill_one, "sensing", signal.SIGKILL),
    ),
    (
        "the wrist's sensor is unplugged",
        "the force fades to 0",
        partial(kill_one, "board", signal.SIGKILL),
    ),
    *(
        (
            f"the display stands still for {seconds:g} s",
            "the drive's watchdog; then a latched fault",
            partial(kill_one, "display", signal.SIGSTOP, stopped_s=seconds),
        )
        for seconds in STOPS_S
    ),
    (
        "the display is killed",
        "the drive's watchdog",
        partial(kill_one, "display", signal.SIGKILL),
    ),
    ("over-temperature", "the drive stops", partial(trouble, "overtemperature")),
    ("the drive falls silent", "its watchdog, or our stop", partial(trouble, "silent")),
    ("the drive's answers are garbled", "our stop", partial(trouble, "garbled"), ("tmcl",)),
    ("another device answers", "our stop", partial(trouble, "wrong"), ("tmcl",)),
    ("the drive's cable is pulled", "its watchdog", partial(trouble, "unplugged")),
)
RESTARTS: tuple[tuple[str, Callable[[Path, str], MotorTrace]], ...] = (
    ("sensing node started anew", sensing_restarted),
    ("display started anew after a fault", display_restarted),
)
