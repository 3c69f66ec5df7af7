"""Faults on the whole emulated bench: time until the tip rests or presses no more.

The time ends when the tip stays at rest or stays almost off the finger, whichever is first. It is
read from the emulated motor's own record, on the clock by which the fault is made.
"""

import math
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

import numpy as np

from benchmarks.benchmark import Benchmark
from protocol.faults import faults_of
from tests.support.emulated_bench import KINDS, BenchFailedError, EmulatedBench, MotorTrace, playing

Result = TypeVar("Result")

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
    found = [(fault, happened(fault)) for fault in FAULTS]
    benchmark.table(
        f"From a fault until the tip rests or is off, most of {REPEATS}",
        ("fault", "what is done", *kinds, "named"),
        [row(fault, outcomes) for fault, outcomes in found],
    )
    restarts = [restarted(kind, name, once) for name, once in RESTARTS for kind in KINDS]
    benchmark.table(
        "Felt after a restart",
        ("restart", "drive", "most N", "fastest N/s", "rise ms"),
        [each.row() for each in restarts],
    )
    # A display that is stopped cannot act, so only its drive's watchdog counts then.
    peace_ms = [
        most_ms(some)
        for fault, outcomes in found
        if not fault.name.startswith("the display stands still")
        for some in outcomes.values()
    ]
    benchmark.judge("time from a fault until the tip rests or is off", 1e-3 * max(peace_ms))
    benchmark.judge("force after a restart", max(each.most_n for each in restarts))
    benchmark.judge("slew after a restart", max(each.most_n_per_s for each in restarts))


def most_ms(outcomes: Sequence[Outcome]) -> float:
    """Return the longest time of a fault; infinite where no attempt came so far."""
    return max((outcome.peace_ms for outcome in outcomes), default=math.inf)


def _shown(figure: float, form: str = ".0f") -> str:
    return f"{figure:{form}}" if math.isfinite(figure) else "none"


def row(fault: "Fault", outcomes: Mapping[str, Sequence[Outcome]]) -> tuple[str, ...]:
    """Return the row of a fault; outcomes: by the kind of drive, where it can have the fault."""
    times = ["–" if kind not in outcomes else _shown(most_ms(outcomes[kind])) for kind in KINDS]
    named = {
        ": ".join(text.split(": ")[:2])
        for some in outcomes.values()
        for outcome in some
        for text in outcome.named
    }
    return fault.name, fault.done, *times, ", ".join(sorted(named))


def happened(fault: "Fault") -> dict[str, list[Outcome]]:
    """Return the results of a fault, repeated, by the kind of drive that can have it."""
    tries = {
        kind: [tried(partial(fault.once, kind)) for _ in range(REPEATS)] for kind in fault.kinds
    }
    return {kind: [each for each in some if each is not None] for kind, some in tries.items()}


def tried(once: Callable[[Path], Result]) -> Result | None:
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
        if signal_number == signal.SIGSTOP:
            bench.stall(name, stopped_s)
        else:
            bench.processes[name].send_signal(signal_number)
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
        raise BenchFailedError(f"no pulse when the fault came: {_named(summary)}")
    # Up to the end of the display, which also moves the tip.
    seen = (motor.time_ns >= at_ns) & (motor.time_ns < last_ns)
    moves = seen & (np.abs(motor.speed_m_per_s) > STILL_M_PER_S)
    presses = seen & (motor.force_n > LIGHT_N)
    peace_ns = min(int(motor.time_ns[here].max(initial=at_ns)) for here in (moves, presses))
    return Outcome((peace_ns - at_ns) / 1e6, tuple(map(str, faults_of(summary))))


def _named(summary: Mapping[str, Any]) -> str:
    return "; ".join(map(str, faults_of(summary))) or "no fault"


def pressed(motor: MotorTrace, at_ns: int) -> bool:
    """Return whether the pulse was felt in the 100 ms before a time."""
    before = (motor.time_ns < at_ns) & (motor.time_ns > at_ns - 100_000_000)
    return bool(before.any() and motor.force_n[before].min() > 0.05)


@dataclass(frozen=True, slots=True)
class Restart:
    """Force and slew at the finger after a restart, infinite where no attempt played, and rise."""

    name: str
    kind: str
    most_n: float = math.inf
    most_n_per_s: float = math.inf
    rise: str = f"failed {TRIES} times"

    def row(self) -> tuple[str, ...]:
        """Return the row of the table."""
        figures = _shown(self.most_n, ".3f"), _shown(self.most_n_per_s, ".1f")
        return self.name, self.kind, *figures, self.rise


def restarted(kind: str, name: str, happens: Callable[[str, Path], MotorTrace]) -> Restart:
    """Return what is felt after a restart."""
    motor = tried(partial(happens, kind))
    if motor is None:
        return Restart(name, kind)
    felt_n = motor.force_n
    slope = (felt_n[STRETCH_MS:] - felt_n[:-STRETCH_MS]) / STRETCH_MS * 1e3
    return Restart(name, kind, float(felt_n.max()), float(slope.max()), rise_ms(felt_n))


def sensing_restarted(kind: str, folder: Path) -> MotorTrace:
    """Kill and restart the sensing node, and return the record from then on."""
    with playing(folder, kind) as bench:
        bench.processes["sensing"].kill()
        bench.await_state("stale")
        time.sleep(AFTER_S)
        return felt_again(bench, bench.start_sensing)


def display_restarted(kind: str, folder: Path) -> MotorTrace:
    """Stop the display until the drive's watchdog acts, restart it, and return the record since."""
    with playing(folder, kind) as bench:
        display = bench.stall("display", STOPPED_S)
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
        raise BenchFailedError(f"at fault: {_named(summary)}")
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


class Fault(NamedTuple):
    """A fault, what the bench does then, a function that makes it once, and drives that have it."""

    name: str
    done: str
    once: Callable[[str, Path], Outcome]
    kinds: Sequence[str] = KINDS


FAULTS = (
    Fault("the film falls silent", "the tip leaves the finger", partial(trouble, "film-silent")),
    Fault(
        "the sensing node is killed",
        "the force fades to 0",
        partial(kill_one, "sensing", signal.SIGKILL),
    ),
    Fault(
        "the wrist's sensor is unplugged",
        "the force fades to 0",
        partial(kill_one, "board", signal.SIGKILL),
    ),
    *(
        Fault(
            f"the display stands still for {seconds:g} s",
            "the drive's watchdog; then a latched fault",
            partial(kill_one, "display", signal.SIGSTOP, stopped_s=seconds),
        )
        for seconds in STOPS_S
    ),
    Fault(
        "the display is killed",
        "the drive's watchdog",
        partial(kill_one, "display", signal.SIGKILL),
    ),
    Fault("over-temperature", "the drive stops", partial(trouble, "overtemperature")),
    Fault("the drive falls silent", "its watchdog, or our stop", partial(trouble, "silent")),
    Fault("the drive's answers are garbled", "our stop", partial(trouble, "garbled"), ("tmcl",)),
    Fault("another device answers", "our stop", partial(trouble, "wrong"), ("tmcl",)),
    Fault("the drive's cable is pulled", "its watchdog", partial(trouble, "unplugged")),
)
RESTARTS: tuple[tuple[str, Callable[[str, Path], MotorTrace]], ...] = (
    ("sensing node started anew", sensing_restarted),
    ("display started anew after a fault", display_restarted),
)
