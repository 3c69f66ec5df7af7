"""Faults on the whole emulated bench: from the fault until the finger is in peace.

In peace is a tip at rest, or one that hardly touches: whichever came first, and stayed. Read in
the emulated motor's own record, on the clock on which the fault is made.
"""

import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.measure import show
from benchmarks.whole_bench import KINDS, BenchFailedError, MotorTrace, WholeBench, playing

REPEATS = 2
TRIES = 3
BAR_MS = 100.0
AFTER_S = 1.0
# From its emulator's start on, for what it does by itself: by then the pulse is felt.
TROUBLE_AFTER_S = 10.0
STOPPED_S = 0.3
RESTARTED_AFTER_S = 4.0
STILL_M_PER_S = 1e-6
# At 0 N the tip is held where it just touches, to a few microsteps of 0.6 mN.
LIGHT_N = 0.01
FORCE_LIMIT_N = 2.5
SLEW_N_PER_S = 50.0
# So long a stretch has no slope of single microsteps.
STRETCH_MS = 10


@dataclass(frozen=True, slots=True)
class Outcome:
    """What a fault led to: ms until peace, the fault's names in the summary, and whether the
    tip still pressed."""

    peace_ms: float
    named: tuple[str, ...]
    pressing: bool


def main() -> None:
    """Print both tables; the bar is 100 ms."""
    rows = [
        row(kind, name, partial(kill_one, kind, *which)) for name, which in KILLED for kind in KINDS
    ]
    rows += [
        row(kind, name, partial(trouble, kind, word)) for name, word in TROUBLES for kind in KINDS
    ]
    show(
        f"From a fault to a finger in peace, {REPEATS} times each; the bar is {BAR_MS:g} ms",
        ("fault", "drive", "median ms", "most ms", "then", "named"),
        rows,
    )
    show(
        f"What reaches the finger; bars: {FORCE_LIMIT_N:g} N, {SLEW_N_PER_S:g} N/s",
        ("peer", "drive", "most N", "fastest N/s", "rise ms"),
        [peer_row(kind, name, source) for name, source in PEERS for kind in KINDS],
    )


def row(kind: str, name: str, once: Callable[[Path], Outcome]) -> tuple[str, ...]:
    """A fault as it stands in the table."""
    outcomes = [found for _ in range(REPEATS) if (found := tried(once)) is not None]
    if not outcomes:
        return name, kind, "", "", "", f"failed {TRIES} times before the fault"
    times_ms = [outcome.peace_ms for outcome in outcomes]
    then = "presses on" if any(outcome.pressing for outcome in outcomes) else "has left"
    named = sorted(
        {": ".join(fault.split(": ")[:2]) for outcome in outcomes for fault in outcome.named}
    )
    return (
        name,
        kind,
        f"{np.median(times_ms):.0f}",
        f"{max(times_ms):.0f}",
        then,
        ", ".join(named) or "",
    )


def tried(once: Callable[[Path], Outcome]) -> Outcome | None:
    """What a fault led to on a bench that was well until then; None where a busy machine had
    brought it to rest before, time after time."""
    for _ in range(TRIES):
        with TemporaryDirectory(prefix="telepulse-") as folder:
            try:
                return once(Path(folder))
            except BenchFailedError as error:
                print(f"once more: {str(error).splitlines()[0]}")
    return None


def kill_one(kind: str, name: str, signal_number: int, folder: Path) -> Outcome:
    """Send a process of the bench a signal; one that is stopped goes on after a while."""
    with playing(folder, kind) as bench:
        at_ns = time.monotonic_ns()
        bench.processes[name].send_signal(signal_number)
        if signal_number == signal.SIGSTOP:
            time.sleep(STOPPED_S)
            bench.processes[name].send_signal(signal.SIGCONT)
        time.sleep(AFTER_S)
        return ended(bench, at_ns)


def trouble(kind: str, word: str, folder: Path) -> Outcome:
    """Something goes wrong in the drive's emulator."""
    options = ("--fault", word, "--fault-after", f"{TROUBLE_AFTER_S:g}")
    with playing(folder, kind, "real_bench", *options) as bench:
        bench.await_state("fault")
        time.sleep(AFTER_S)
        return ended(bench, None)


def ended(bench: WholeBench, at_ns: int | None) -> Outcome:
    """Stop the bench, and see in the motor's record what came of a fault then; None: of its
    own trouble."""
    last_ns = time.monotonic_ns()
    summary = bench.end()
    motor = bench.motor()
    at_ns = at_ns or motor.trouble_ns
    if at_ns is None or not pressed(motor, at_ns):
        raise BenchFailedError(f"no pulse when the fault came: {summary.get('faults')}")
    # Until it is told to end, which moves it as well.
    seen = (motor.time_ns >= at_ns) & (motor.time_ns < last_ns)
    moves = seen & (np.abs(motor.speed_m_per_s) > STILL_M_PER_S)
    presses = seen & (motor.force_n > LIGHT_N)
    peace_ns = min(int(motor.time_ns[here].max(initial=at_ns)) for here in (moves, presses))
    pressing = bool(motor.force_n[seen][-1] > LIGHT_N)
    return Outcome((peace_ns - at_ns) / 1e6, tuple(summary.get("faults", ())), pressing)


def pressed(motor: MotorTrace, at_ns: int) -> bool:
    """Whether the pulse was felt in the 100 ms before."""
    before = (motor.time_ns < at_ns) & (motor.time_ns > at_ns - 100_000_000)
    return bool(before.any() and motor.force_n[before].min() > 0.05)


def peer_row(kind: str, name: str, force_n: Callable[[int], float] | None) -> tuple[str, ...]:
    """What a peer's stream does to the finger; without one, a sensing node's restart."""
    for _ in range(TRIES):
        with TemporaryDirectory(prefix="telepulse-") as folder:
            try:
                motor = (
                    restarted(Path(folder), kind)
                    if force_n is None
                    else hostile(Path(folder), kind, force_n)
                )
            except BenchFailedError as error:
                print(f"once more: {str(error).splitlines()[0]}")
                continue
        felt_n = motor.force_n
        slope = (felt_n[STRETCH_MS:] - felt_n[:-STRETCH_MS]) / STRETCH_MS * 1e3
        return name, kind, f"{felt_n.max():.3f}", f"{slope.max():.1f}", rise_ms(felt_n)
    return name, kind, "", "", f"failed {TRIES} times"


def hostile(folder: Path, kind: str, force_n: Callable[[int], float]) -> MotorTrace:
    """A wrist that senses what no wrist does."""
    lines = "\n".join(f"{force_n(ms):g}" for ms in range(1_000))
    (folder / "hostile.csv").write_text(f"force\n{lines}\n", "utf-8")
    source = folder / "hostile.toml"
    source.write_text(
        '[sensing.source]\nkind = "recording"\npath = "hostile.csv"\ncolumn = "force"\n'
        'rate = "1 kHz"\nunit = "N"\nrepeat = "loop"\n',
        "utf-8",
    )
    with playing(folder, kind, str(source)) as bench:
        time.sleep(2 * AFTER_S)
        bench.end()
        return bench.motor()


def restarted(folder: Path, kind: str) -> MotorTrace:
    """The sensing node is killed and started again: the record from then on."""
    with playing(folder, kind) as bench:
        bench.processes["sensing"].kill()
        time.sleep(AFTER_S)
        began_ns = time.monotonic_ns()
        bench.start_sensing()
        time.sleep(RESTARTED_AFTER_S)
        summary = bench.end()
        motor = bench.motor()
        if summary["faults"]:
            raise BenchFailedError(f"at fault: {summary['faults']}")
    later = motor.time_ns >= began_ns
    return MotorTrace(*(values[later] for values in motor[:3]), motor.trouble_ns)


def rise_ms(felt_n: "np.typing.NDArray[np.float64]") -> str:
    """How long the force took from 10 % to 90 % of its usual size, the first time."""
    usual_n = np.median(felt_n[felt_n > LIGHT_N])
    first, then = np.argmax(felt_n > 0.1 * usual_n), np.argmax(felt_n > 0.9 * usual_n)
    return f"{then - first}"


KILLED = (
    ("sensing node killed", ("sensing", signal.SIGKILL)),
    ("board's cable pulled", ("board", signal.SIGKILL)),
    ("display stopped for 0.3 s", ("display", signal.SIGSTOP)),
    ("display killed", ("display", signal.SIGKILL)),
)
TROUBLES = (
    ("film silent", "film-silent"),
    ("over-temperature", "overtemperature"),
    ("drive falls silent", "silent"),
    ("drive's cable pulled", "unplugged"),
)
PEERS: tuple[tuple[str, Callable[[int], float] | None], ...] = (
    ("1000 N", lambda _: 1_000.0),
    ("±1e29 N by 40 ms", lambda ms: 1e29 if ms // 40 % 2 else -1e29),
    ("±1e29 N by 1 ms", lambda ms: 1e29 if ms % 2 else -1e29),
    ("restarted", None),
)
