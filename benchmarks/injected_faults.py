"""Drives and films that report false values: the felt force, and the time until it is reported.

Every fault of `tests.support.fault_injection` on both kinds of drive, with a film and without, by
the product's own code in virtual time. Cases that are chosen run with soft and stiff fingers too.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from benchmarks.benchmark import Benchmark
from tests.support.fault_injection import FaultKind
from tests.support.fault_runs import (
    BAR_ABOVE_MS,
    BAR_FORCE_N,
    BAR_OFF_MS,
    KINDS,
    LIMIT_N,
    FaultCase,
    FaultOutcome,
    hostile_stream,
    paper_pulse,
    run_fault,
)

SIZES: dict[FaultKind, tuple[str | None, ...]] = {
    FaultKind.REVERSED: (None,),
    FaultKind.REVERSED_ENCODER: (None,),
    FaultKind.GAIN: ("0.3", "0.5", "2", "3"),
    FaultKind.GAIN_ENCODER: ("0.3", "3"),
    FaultKind.NO_RETRACTION: (None,),
    FaultKind.POSITION_FROZEN: (None,),
    FaultKind.POSITION_JUMP: ("0.5 mm", "-0.5 mm"),
    FaultKind.POSITION_DRIFT: ("1 mm/s", "-1 mm/s"),
    FaultKind.POSITION_NOISE: ("20 µm", "200 µm"),
    FaultKind.DELAYED: ("20 ms", "30 ms", "45 ms"),
    FaultKind.LOST: ("0.3", "1"),
    FaultKind.DUPLICATED: ("1",),
    FaultKind.GARBAGE: ("0.3", "1"),
    FaultKind.FILM_ZERO: (None,),
    FaultKind.FILM_FROZEN: (None,),
    FaultKind.FILM_SCALED: ("0.3", "0.5", "2", "3"),
    FaultKind.FILM_NOISE: ("0.2 N",),
    FaultKind.FILM_LATE: ("10 ms", "15 ms", "20 ms", "60 ms"),
}
CASES = (
    FaultCase(FaultKind.REVERSED, from_start=True),
    FaultCase(FaultKind.REVERSED_ENCODER, from_start=True),
    *(FaultCase(kind, size) for kind, sizes in SIZES.items() for size in sizes),
)
# Stiffness of the finger over the scene's.
FINGERS = (0.3, 1.0, 3.0)
STREAMS: dict[str, Callable[[], Callable[[int], float]]] = {
    "pulse": paper_pulse,
    "hostile": lambda: hostile_stream,
}


@dataclass(frozen=True, slots=True)
class Run:
    """One run of the table; case: None for a run without a fault."""

    case: FaultCase | None
    kind: str
    with_film: bool
    stream: str
    finger: float

    def outcome(self) -> FaultOutcome:
        """Run the case and return its result."""
        return run_fault(self.case, self.kind, self.with_film, STREAMS[self.stream](), self.finger)

    @property
    def name(self) -> str:
        """Return the fault with its size, as in the emulator's options."""
        if self.case is None:
            return "none"
        begin = "from the start" if self.case.from_start else ""
        return " ".join(word for word in (self.case.kind.value, self.case.size, begin) if word)


def rows(benchmark: Benchmark) -> list[tuple[str, ...]]:
    """Return the table's rows, of the chosen faults."""
    kinds = set(benchmark.choose(sorted({case.kind.value for case in CASES})))
    cases = [case for case in CASES if case.kind.value in kinds]
    if benchmark.quick:
        cases = cases[:1]
    runs = [
        Run(case, kind, with_film, stream, finger)
        for case in (None, *cases)
        for finger in (FINGERS if benchmark.cases else (1.0,))
        for with_film in (True, False)
        for stream in STREAMS
        for kind in KINDS
        if case is None or with_film or not case.kind.value.startswith("film")
    ]
    outcomes = dict(zip(runs, benchmark.run(Run.outcome, runs), strict=True))
    table: list[tuple[str, ...]] = []
    for run, outcome in outcomes.items():
        faultless = outcomes[replace(run, case=None)]
        missed = outcome.missed(faultless.error_n, run.case is None or run.case.obeys)
        table.append(
            (
                run.name,
                f"{run.finger:g}",
                "film" if run.with_film else "none",
                run.stream,
                run.kind,
                f"{outcome.most_n:.2f}",
                str(outcome.above_ms),
                "" if outcome.named_ms is None else str(outcome.named_ms),
                "" if outcome.off_ms is None else str(outcome.off_ms),
                f"{outcome.error_n:.2f}",
                " ".join(missed) or "none",
                "" if outcome.stiffness is None else f"{outcome.stiffness:.2f}",
                (outcome.named or outcome.warned)[:50],
            )
        )
    return table


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    benchmark.table(
        f"Injected faults of drives and films; bars: {BAR_FORCE_N:g} N, {BAR_ABOVE_MS} ms above the"
        f" limit of {LIMIT_N:g} N, off the finger {BAR_OFF_MS / 1e3:g} s after the fault, named",
        (
            "fault",
            "finger",
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
        rows(benchmark),
    )
