"""Runs of one injected fault of a drive or a film, on a bench in virtual time."""

from collections.abc import Callable
from dataclasses import dataclass

from display_node.scene import DisplayScene
from display_node.telemetry.alerts import AlertKind, alerts
from protocol.errors import TelepulseError
from telepulse.emulators.motor import MotorState
from tests.support.fault_injection import FaultKind, parse_fault
from tests.support.sender import MS, display_scene
from tests.support.streams import synthetic
from tests.support.threaded_bench import ThreadedBench

KINDS = ("tmcl", "cia402", "stepdir")
# Shipped scenes that are not named after their kind of drive.
BENCHES = {"stepdir": "class_bench"}
LIMIT_N = 2.5
BAR_FORCE_N = 1.25 * LIMIT_N
# A microstep at the limit is 6 mN, which counts as the limit.
LIMIT_AND_STEP_N = LIMIT_N + 0.01
BAR_ABOVE_MS = 50
BAR_OFF_MS = 1_000
PLAYED_MS = 1_500
AFTER_MS = 3_000
# A tip that is off the finger for this time stays off.
OFF_MS = 250
# The tip is off the finger below this force.
TOUCH_N = 0.01
# The tip has left for good if it did not touch for this time at the end of a run.
LEFT_FOR_MS = 100
# An excess over the faultless error that need not be reported.
HARMLESS_N = 0.25
# The target is felt within this time.
FELT_WITHIN_MS = 20
# A drive that turns the wrong way, or not at all, cannot be withdrawn by commands.
DISOBEDIENT = (FaultKind.REVERSED, FaultKind.REVERSED_ENCODER, FaultKind.NO_RETRACTION)


@dataclass(frozen=True, slots=True)
class FaultCase:
    """A fault on a bench. from_start: it is present before the drive homes."""

    kind: FaultKind
    size: str | None = None
    from_start: bool = False

    @property
    def obeys(self) -> bool:
        """Return whether the drive still obeys, so that the tip can be withdrawn."""
        return self.kind not in DISOBEDIENT


@dataclass(frozen=True, slots=True)
class FaultOutcome:
    """Result of a fault.

    most_n: the greatest felt force. above_ms: time above the limit. named: the faults that the
    display reported. named_ms: from the start of the fault to its report. off_ms: from the report
    until the tip is off the finger for good, None if it stays on. error_n: the greatest excess of
    the felt over the target force. warned: an alert without a latched fault. stiffness: the
    stiffness of the finger that the display has learnt.
    """

    most_n: float
    above_ms: int
    named: str
    named_ms: int | None
    off_ms: int | None
    error_n: float
    warned: str = ""
    stiffness: float | None = None

    def missed(self, faultless_error_n: float, obeys: bool = True) -> list[str]:
        """Return the bars that it misses.

        A fault that is harmless at the finger need not be reported, and a drive that does not obey
        need not leave the finger. faultless_error_n: `error_n` without a fault.
        """
        harmless = not self.named and self.error_n <= faultless_error_n + HARMLESS_N
        off = self.off_ms is not None and self.off_ms <= BAR_OFF_MS
        bars = {
            "force": self.most_n <= BAR_FORCE_N,
            "time": self.above_ms <= BAR_ABOVE_MS,
            "name": bool(self.named or self.warned or harmless),
            "off": off or not (self.named and obeys),
        }
        return [name for name, met in bars.items() if not met]


def paper_pulse() -> Callable[[int], float]:
    """Return the paper's pulse in N, as a function of time in ms."""
    source = synthetic(preset="paper", rate="1 kHz", peak_to_peak="0.3 N", preload="0.3 N")
    values = source.take(12_000)[:, 0].tolist()
    return lambda ms: values[ms % len(values)]


def hostile_stream(ms: int) -> float:
    """Return forces that jump between zero and far beyond the limit, every 300 ms."""
    return 1_000.0 if ms // 300 % 2 else 0.0


def bench_scene(kind: str) -> DisplayScene:
    """Return the scene of the emulated bench with a kind of drive."""
    return display_scene(BENCHES.get(kind, f"{kind}_bench"))


def run_fault(
    case: FaultCase | None,
    kind: str,
    with_film: bool,
    force_n: Callable[[int], float],
    finger: float = 1.0,
) -> FaultOutcome:
    """Inject a fault while the pulse is felt, and return what resulted; None injects none.

    finger: its stiffness, as a factor of the scene's.
    """
    felt: list[MotorState] = []
    with ThreadedBench(bench_scene(kind), force_n, with_film, felt.append, finger) as bench:
        target_n: dict[int, float] = {}
        bench.on_tick = lambda now_ns, force_n: target_n.setdefault(now_ns // MS, force_n)
        from_start = case is not None and case.from_start
        if not from_start:
            bench.start()
            bench.run(PLAYED_MS)
            assert not bench.faults, bench.faults
        began_ns = bench.world.now_ns
        if case is not None:
            bench.motor.injector.begin(parse_fault(case.kind, case.size), began_ns)
        warned, stiffness = "", None
        try:
            if from_start:
                bench.start()
        except TelepulseError as error:
            named, bench.fault_ns = f"not started: {error}", bench.world.now_ns
            bench.run(AFTER_MS)
        else:
            for _ in range(AFTER_MS // OFF_MS):
                bench.run(OFF_MS)
                if bench.faults and all(moment.force_n <= TOUCH_N for moment in felt[-OFF_MS:]):
                    break
            named, summary = "; ".join(bench.faults), bench.display.summary()
            shown = alerts(bench.display.state, summary.to_dict())
            warned = "; ".join(x.text for x in shown if x.kind is AlertKind.STIFFNESS)
            stiffness = summary.finger_stiffness if with_film else None
    fault_ns, end_ns = bench.fault_ns, felt[-1].time_ns
    last_ns = max((moment.time_ns for moment in felt if moment.force_n > TOUCH_N), default=0)
    scored = [moment for moment in felt if began_ns <= moment.time_ns <= (fault_ns or end_ns)]
    off_ms = None
    if fault_ns is not None and end_ns - last_ns > LEFT_FOR_MS * MS:
        off_ms = max(0, last_ns - fault_ns) // MS
    return FaultOutcome(
        most_n=max(moment.force_n for moment in felt),
        above_ms=sum(moment.force_n > LIMIT_AND_STEP_N for moment in felt),
        named=named,
        named_ms=None if fault_ns is None else (fault_ns - began_ns) // MS,
        off_ms=off_ms,
        error_n=_greatest_error(scored, target_n),
        warned=warned,
        stiffness=stiffness,
    )


def _greatest_error(felt: list[MotorState], target_n: dict[int, float]) -> float:
    error_n = 0.0
    for moment in felt:
        ms = moment.time_ns // MS
        around = range(ms - FELT_WITHIN_MS, ms + FELT_WITHIN_MS + 1)
        near = [target_n[there] for there in around if there in target_n]
        if near:
            error_n = max(error_n, moment.force_n - max(near), min(near) - moment.force_n)
    return error_n
