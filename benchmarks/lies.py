"""Drives and films that report what is not so: what is felt, and when it is named.

Every fault of `telepulse.emulators.fault_injection` on both kinds of drive, with a film and
without, by the product's own code in virtual time. `python -m benchmarks.lies NAME` runs the
faults of one name, `python -m benchmarks.lies NAME 3` those on a finger three times as stiff as
the scene's.
"""

import os
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

from benchmarks.measure import show
from benchmarks.virtual_bench import MS, VirtualBench
from display_node.scene import DisplayScene
from display_node.telemetry.alerts import STIFFNESS, alerts
from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene
from protocol.errors import TelepulseError
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource
from telepulse.emulators.fault_injection import FaultKind, InjectedFault, parse_fault
from telepulse.emulators.motor import MotorState

KINDS = ("tmcl", "cia402")
LIMIT_N = 2.5
BAR_FORCE_N = 1.25 * LIMIT_N
# A microstep at the limit is 6 mN: so much more is no more than the limit.
LIMIT_AND_STEP_N = LIMIT_N + 0.01
BAR_ABOVE_MS = 50
BAR_OFF_MS = 1_000
PLAYED_MS = 1_500
AFTER_MS = 3_000
# Off for so long, it stays off.
OFF_MS = 250
# Felt beyond what is felt without a lie; less need not be named.
HARMLESS_N = 0.25
# Off the finger.
TOUCH_N = 0.01
# The hostile stream's jumps, and half its period.
HOSTILE_N, HOSTILE_MS = 1_000.0, 300


# A drive that turns the other way, or not at all, cannot be withdrawn by commands.
DISOBEDIENT = (
    FaultKind.REVERSED,
    FaultKind.REVERSED_ENCODER,
    FaultKind.NO_RETRACTION,
)


@dataclass(frozen=True, slots=True)
class Case:
    """A lie on a bench. from_start: it is there before the drive homes."""

    kind: FaultKind
    size: str | None = None
    from_start: bool = False

    @property
    def lie(self) -> InjectedFault:
        """The lie itself."""
        return parse_fault(self.kind, self.size)

    @property
    def name(self) -> str:
        """The lie with its size, as the emulator's options have it."""
        parts = (self.kind.value, self.size or "", "from the start" if self.from_start else "")
        return " ".join(part for part in parts if part)

    @property
    def obeys(self) -> bool:
        """Return whether the drive still obeys, so that the tip can be withdrawn."""
        return self.kind not in DISOBEDIENT

    @property
    def of_film(self) -> bool:
        """Return whether the lie is the film's, not the drive's."""
        return self.kind.value.startswith("film")


CASES = (
    Case(FaultKind.REVERSED, from_start=True),
    Case(FaultKind.REVERSED_ENCODER, from_start=True),
    Case(FaultKind.REVERSED),
    Case(FaultKind.REVERSED_ENCODER),
    *(Case(FaultKind.GAIN, size) for size in ("0.3", "0.5", "2", "3")),
    *(Case(FaultKind.GAIN_ENCODER, size) for size in ("0.3", "3")),
    Case(FaultKind.NO_RETRACTION),
    Case(FaultKind.POSITION_FROZEN),
    *(Case(FaultKind.POSITION_JUMP, size) for size in ("0.5 mm", "-0.5 mm")),
    *(Case(FaultKind.POSITION_DRIFT, size) for size in ("1 mm/s", "-1 mm/s")),
    *(Case(FaultKind.POSITION_NOISE, size) for size in ("20 µm", "200 µm")),
    *(Case(FaultKind.DELAYED, size) for size in ("20 ms", "30 ms", "45 ms")),
    *(Case(FaultKind.LOST, size) for size in ("0.3", "1")),
    Case(FaultKind.DUPLICATED, "1"),
    *(Case(FaultKind.GARBAGE, size) for size in ("0.3", "1")),
    Case(FaultKind.FILM_ZERO),
    Case(FaultKind.FILM_FROZEN),
    *(Case(FaultKind.FILM_SCALED, size) for size in ("0.3", "0.5", "2", "3")),
    Case(FaultKind.FILM_NOISE, "0.2 N"),
    *(Case(FaultKind.FILM_LATE, size) for size in ("10 ms", "15 ms", "20 ms", "60 ms")),
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a lie.

    most_n: the most felt force; above_ms: time above the limit; named: the first fault, empty for
    none; named_ms: from the lie's begin to it; off_ms: from the fault until the tip is off the
    finger for good, None where it stays on; error_n: the most that was felt beyond what was wanted;
    warned: an alert of the display that latches nothing; stiffness: of the finger as it was learnt.
    """

    most_n: float
    above_ms: int
    named: str
    named_ms: int | None
    off_ms: int | None
    error_n: float
    warned: str = ""
    stiffness: float | None = None

    def missed(self, honest_error_n: float, obeys: bool = True) -> list[str]:
        """The bars that it misses; honest_error_n is what is felt beyond what is wanted without a
        lie. One that changes nothing at the finger need not be named, and a drive that does not
        obey need not leave it.
        """
        harmless = not self.named and self.error_n <= honest_error_n + HARMLESS_N
        missed = []
        if self.most_n > BAR_FORCE_N:
            missed.append("force")
        if self.above_ms > BAR_ABOVE_MS:
            missed.append("time")
        if not (self.named or self.warned or harmless):
            missed.append("name")
        if self.named and obeys and (self.off_ms is None or self.off_ms > BAR_OFF_MS):
            missed.append("off")
        return missed


def paper_pulse() -> Callable[[int], float]:
    """The paper's pulse, by ms."""
    keys = {"preset": "paper", "rate": "1 kHz", "peak_to_peak": "0.3 N", "preload": "0.3 N"}
    source = SyntheticSource(SyntheticScene.model_validate({"kind": "synthetic", **keys}))
    values = source.take(12_000)[:, 0].tolist()
    return lambda ms: values[ms % len(values)]


def hostile_stream(ms: int) -> float:
    """Jumps that no wrist makes: the force limit, and nothing."""
    return HOSTILE_N if ms // HOSTILE_MS % 2 else 0.0


def bench_scene(kind: str) -> DisplayScene:
    """The scene of the emulated bench."""
    return load_section(find_scene(f"{kind}_bench"), "display", DisplayScene)


def lied(
    case: Case | None,
    kind: str,
    with_film: bool,
    force_n: Callable[[int], float],
    finger: float = 1.0,
) -> Outcome:
    """Run a lie from when the pulse is felt; return its result. None runs the honest bench.

    finger: its stiffness, as a factor of the scene's.
    """
    felt: list[MotorState] = []
    with VirtualBench(bench_scene(kind), force_n, with_film, felt.append, finger) as bench:
        wanted: dict[int, float] = {}
        bench.on_tick = lambda now_ns, target_n: wanted.setdefault(now_ns // MS, target_n)
        if case is not None and case.from_start:
            bench.motor.injector.begin(case.lie, bench.world.now_ns)
            began_ns = bench.world.now_ns
            try:
                bench.start()
            except TelepulseError as error:
                fault_ns = bench.world.now_ns
                bench.run(AFTER_MS)
                return _outcome(felt, wanted, began_ns, fault_ns, f"not started: {error}")
        else:
            bench.start()
            bench.run(PLAYED_MS)
            assert not bench.faults, bench.faults
            began_ns = bench.world.now_ns
            if case is not None:
                bench.motor.injector.begin(case.lie, began_ns)
        _run_on(bench, felt)
        outcome = _outcome(felt, wanted, began_ns, bench.fault_ns, "; ".join(bench.faults))
        summary = bench.display.summary()
        warned = [a for a in alerts(bench.display.state, summary.to_dict()) if a.name == STIFFNESS]
        return replace(
            outcome,
            warned="; ".join(f"{alert.name} {alert.text}" for alert in warned),
            stiffness=summary.finger_stiffness if with_film else None,
        )


def _run_on(bench: VirtualBench, felt: list[MotorState]) -> None:
    """Until the end, or a fault after which the tip has been off the finger for a while."""
    for _ in range(AFTER_MS // OFF_MS):
        bench.run(OFF_MS)
        if bench.faults and all(moment.force_n <= TOUCH_N for moment in felt[-OFF_MS:]):
            return


def _outcome(
    felt: list[MotorState],
    wanted: dict[int, float],
    began_ns: int,
    fault_ns: int | None,
    named: str,
) -> Outcome:
    pressing = [moment.time_ns for moment in felt if moment.force_n > TOUCH_N]
    last_ns, end_ns = max(pressing, default=0), felt[-1].time_ns
    off_ms = None
    if fault_ns is not None and end_ns - last_ns > 100 * MS:
        off_ms = max(0, last_ns - fault_ns) // MS
    error_n = 0.0
    for moment in felt:
        if moment.time_ns < began_ns or (fault_ns is not None and moment.time_ns > fault_ns):
            continue
        # What is wanted now is felt within some ms.
        ms = moment.time_ns // MS
        near = [wanted[there] for there in range(ms - 20, ms + 21) if there in wanted]
        if near:
            error_n = max(error_n, moment.force_n - max(near), min(near) - moment.force_n)
    return Outcome(
        most_n=max(moment.force_n for moment in felt),
        above_ms=sum(moment.force_n > LIMIT_AND_STEP_N for moment in felt),
        named=named,
        named_ms=None if fault_ns is None else (fault_ns - began_ns) // MS,
        off_ms=off_ms,
        error_n=error_n,
    )


@dataclass(frozen=True, slots=True)
class Run:
    """One run of the table; case None: without a lie."""

    case: Case | None
    kind: str
    with_film: bool
    stream: str
    finger: float = 1.0

    def outcome(self) -> Outcome:
        """Run the case and return its result."""
        return lied(self.case, self.kind, self.with_film, STREAMS[self.stream](), self.finger)


STREAMS: dict[str, Callable[[], Callable[[int], float]]] = {
    "pulse": paper_pulse,
    "hostile": lambda: hostile_stream,
}


def rows(name: str = "", finger: float = 1.0) -> list[tuple[str, ...]]:
    """Return the table's rows, of the lies of one name or of all."""
    runs = [
        Run(case, kind, with_film, stream, finger)
        for case in (None, *CASES)
        for with_film in (True, False)
        for stream in STREAMS
        for kind in KINDS
        if case is None or (name in ("", case.kind.value) and (with_film or not case.of_film))
    ]
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        outcomes = dict(zip(runs, pool.map(Run.outcome, runs), strict=True))
    table = []
    for run, outcome in outcomes.items():
        honest = outcomes[replace(run, case=None)]
        table.append(
            (
                run.case.name if run.case is not None else "none",
                "film" if run.with_film else "none",
                run.stream,
                run.kind,
                f"{outcome.most_n:.2f}",
                str(outcome.above_ms),
                "" if outcome.named_ms is None else str(outcome.named_ms),
                "" if outcome.off_ms is None else str(outcome.off_ms),
                f"{outcome.error_n:.2f}",
                " ".join(outcome.missed(honest.error_n, run.case is None or run.case.obeys))
                or "none",
                "" if outcome.stiffness is None else f"{outcome.stiffness:.2f}",
                (outcome.named or outcome.warned)[:50],
            )
        )
    return table


def main(name: str = "", finger: str = "1") -> None:
    """Print the table."""
    show(
        f"Lies of drives and films; bars: {BAR_FORCE_N:g} N, {BAR_ABOVE_MS} ms above the limit of"
        f" {LIMIT_N:g} N, off the finger {BAR_OFF_MS / 1e3:g} s after the fault, named",
        (
            "lie",
            "film",
            "stream",
            "drive",
            "most N",
            "above ms",
            "named ms",
            "off ms",
            "error N",
            "bars missed",
            "stiffness",
            "named",
        ),
        rows(name, float(finger)),
    )


if __name__ == "__main__":
    main(*sys.argv[1:3])
