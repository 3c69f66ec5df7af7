"""Prediction under "auto": its first seconds, and on all pulses beside buffering.

The pulses of the second table have a height of 0.3 N on a static force. Those of
`make bench ARGS=prediction` are scored after 20 s of learning. Two pulses change after `TURN_S`, to
fibrillation and to a moving hand, and are scored from then on.
"""

import math
import statistics
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.benchmark import Benchmark
from display_node.prediction import PredictorName
from protocol.config.scene_file import find_scene
from protocol.summary.fields import ErrorWindow
from protocol.ticks import TickState
from sensing_node.sources.heart import NOMINAL_BEAT_S
from sensing_node.sources.recorded import RecordingScene
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import STREAM_BEGINS_NS, Simulation
from tests.support.drawn_pulses import (
    NOISE,
    RATE_HZ,
    SCORED_FROM_S,
    Beats,
    Floats,
    drawn,
    fibrillating,
    make_rhythm,
    pulses,
    through_chain,
)

LINKS = {
    "20±3 ms, 1 % loss": "delay=20ms,jitter=3ms,loss=1%",
    "40±10 ms": "delay=40ms,jitter=10ms",
    "tcp stalls": "delay=40ms,loss=1%,transport=tcp",
}
FIRST_LINK = "delay=40ms,jitter=10ms,loss=1%"
SEEDS = 20
FIRST_S = 31.0
IN_PHASE_NS = 5_000_000
SECONDS, TURN_S = 50.0, 30.0
SIZE_N, STATIC_N = 0.3, 0.75
# Hold-down force of a moving hand, which changes twice a second.
SHIFT_N, SHIFTS_HZ = 0.1, 2
TURNS = ("fibrillation begins", "the arm moves")
PREDICTORS: tuple[PredictorName, ...] = ("stack", "linear")


def main(benchmark: Benchmark) -> None:
    """Print both tables."""
    show_learning(benchmark)
    show_trust(benchmark)


class Start(NamedTuple):
    """Windows of a run, and when E was first reduced, and first below 5 ms, in s of the stream."""

    windows: list[ErrorWindow]
    reduced_s: float
    in_phase_s: float


def show_learning(benchmark: Benchmark) -> None:
    """Print E and the errors second by second, medians over the seeds."""
    seeds = 1 if benchmark.quick else benchmark.seeds or SEEDS
    starts = benchmark.run(start, range(1, seeds + 1))
    rows = []
    for each in zip(*(start.windows for start in starts), strict=False):
        delay_ms = statistics.median(window.playout_delay_ms for window in each)
        aligned, in_phase = (
            1e3 * statistics.median(error for error in errors if error is not None)
            for errors in zip(*((w.aligned_n, w.in_phase_n) for w in each), strict=True)
        )
        times = f"{each[0].from_s:.0f} to {each[0].to_s:.0f}"
        rows.append((times, f"{delay_ms:.1f}", f"{aligned:.2f}", f"{in_phase:.2f}"))
    benchmark.table(
        f"radial over {FIRST_LINK}, E = auto, medians of {seeds} seeds",
        ("s", "E, ms", "aligned, mN", "in phase, mN"),
        rows,
    )
    reduced_s, in_phase_s = (
        statistics.median(getattr(start, name) for start in starts)
        for name in ("reduced_s", "in_phase_s")
    )
    print(f"E reduced after {reduced_s:.1f} s, below 5 ms after {in_phase_s:.1f} s (medians)")


def start(seed: int) -> Start:
    """Play the beginning of a stream."""
    scene = load_scene(find_scene("radial"))
    source = scene.sensing.source
    assert isinstance(source, SyntheticScene)
    sensing = scene.sensing.model_copy(update={"source": source.model_copy(update={"seed": seed})})
    ticks: list[tuple[int, bool, int]] = []

    def watch(state: TickState) -> None:
        ticks.append((state.now_ns, state.trusted, state.playout_delay_ns))

    played = replace(scene, sensing=sensing, link=parse_link(FIRST_LINK))
    summary = Simulation(played, seed).run(FIRST_S, watch=watch)
    first_ns = ticks[0][0]
    reduced_ns = next((now_ns for now_ns, trusted, _ in ticks if trusted), ticks[-1][0])
    in_phase_ns = next((now for now, _, delay in ticks if delay < IN_PHASE_NS), ticks[-1][0])
    return Start(summary.windows, *((t - first_ns) * 1e-9 for t in (reduced_ns, in_phase_ns)))


class Case(NamedTuple):
    """A pulse in N, as sensed and true, over a link, with a predictor, scored from a time on."""

    pulse: str
    sensed_n: Floats
    true_n: Floats
    from_s: float
    link: str
    predictor: PredictorName

    def __str__(self) -> str:
        return f"{self.pulse} over {self.link} with {self.predictor}"


class Score(NamedTuple):
    """RMS errors over the pulse's height, mean E in ms, and when E was above 20 ms, in s."""

    aligned: float
    in_phase: float
    delay_ms: float
    risen_s: float


def show_trust(benchmark: Benchmark) -> None:
    """Print the errors and E of each pulse over each link."""
    links = dict(list(LINKS.items())[: 1 if benchmark.quick else None])
    steady = [(each.name, each.sensed, each.true, SCORED_FROM_S) for each in pulses(SECONDS, 1)]
    steady = steady[:1] if benchmark.quick else steady
    turning = [(name, *turned(name), TURN_S) for name in TURNS]
    cases = [
        Case(name, _in_n(sensed, true), _in_n(true, true), from_s, link, predictor)
        for name, sensed, true, from_s in steady + turning
        for link in links.values()
        for predictor in PREDICTORS
    ]
    scores = {
        (case.pulse, case.link, case.predictor): score
        for case, score in zip(cases, benchmark.run(score, cases), strict=True)
    }
    rows = []
    for name, *_ in steady + turning:
        for link, text in links.items():
            stack, linear = (scores[name, text, predictor] for predictor in PREDICTORS)
            rows.append(
                (
                    *(name, link, f"{stack.aligned - linear.aligned:+.2%}"),
                    *(f"{stack.in_phase:.1%}", f"{linear.in_phase:.1%}"),
                    *(f"{stack.delay_ms:.1f}", f"{linear.delay_ms:.1f}"),
                    f"{stack.risen_s:.1f}" if name in TURNS else "",
                )
            )
    benchmark.table(
        "E = auto: RMS errors over the pulse's height, E in ms, and when E exceeds 20 ms (s)",
        (
            *("pulse", "link", "aligned, stack over linear", "in phase, stack", "linear"),
            *("E, stack", "E, linear", "E above 20 ms after"),
        ),
        rows,
    )


def score(case: Case) -> Score:
    """Play a case."""
    true_n, errors_n, delays = case.true_n, [], []

    def watch(felt: TickState) -> None:
        now_s = (felt.now_ns - STREAM_BEGINS_NS) * 1e-9
        delay_s = felt.playout_delay_ns * 1e-9
        if now_s * RATE_HZ < len(true_n) - 1:
            now_n, played_n = (_at(true_n, at_s) for at_s in (now_s, now_s - delay_s))
            errors_n.append((felt.felt_n - played_n, felt.felt_n - now_n))
            delays.append((now_s - case.from_s, delay_s))

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "pulse.npy")
        np.save(path, case.sensed_n)
        seconds = min(SECONDS, len(true_n) / RATE_HZ - 1)
        Simulation(_scene(path, case), 1).run(seconds, case.from_s, watch)
    aligned, in_phase = np.sqrt(np.mean(np.square(errors_n), axis=0)) / SIZE_N
    risen_s = next((at_s for at_s, delay_s in delays if delay_s > 0.02), math.nan)
    mean_ms = 1e3 * float(np.mean([delay_s for _, delay_s in delays]))
    return Score(float(aligned), float(in_phase), mean_ms, risen_s)


def turned(name: str) -> tuple[Floats, Floats]:
    """Return one of `TURNS` at 1 kHz, as sensed and true."""
    rng = np.random.default_rng(TURNS.index(name))
    calm = make_rhythm(rng, SECONDS, 0.04, lambda _: 75.0)
    if name == "the arm moves":
        true = through_chain(drawn(calm, "wide", SECONDS, NOMINAL_BEAT_S))
        turn = RATE_HZ * round(TURN_S)
        height = float(np.ptp(true[turn // 2 : turn]))
        shifts = rng.standard_normal(round((SECONDS - TURN_S) * SHIFTS_HZ))
        moved = np.repeat(shifts * height * SHIFT_N / SIZE_N, RATE_HZ // SHIFTS_HZ)
        true[turn:] += through_chain(np.concatenate([[0.0], moved]))[1:]
    else:
        before = calm.intervals_s[: np.searchsorted(np.cumsum(calm.intervals_s), TURN_S)]
        after = fibrillating(rng, SECONDS - TURN_S)
        intervals_s = np.concatenate([before, after.intervals_s])
        beats = Beats(intervals_s, np.ones(len(intervals_s)))
        true = through_chain(drawn(beats, "wide", SECONDS, NOMINAL_BEAT_S))
    return true + NOISE * true.std() * rng.standard_normal(len(true)), true


def _in_n(pulse: Floats, true: Floats) -> Floats:
    """Return a pulse with the height that `true` has before the turn scaled to `SIZE_N`."""
    settled = true[round(RATE_HZ * SCORED_FROM_S) : round(RATE_HZ * TURN_S)]
    low, high = np.percentile(settled, [0.5, 99.5])
    return np.asarray(STATIC_N + SIZE_N * pulse / (high - low))


def _at(true_n: Floats, at_s: float) -> float:
    first = max(int(at_s * RATE_HZ), 0)
    before, after = true_n[first : first + 2]
    return float(before + (at_s * RATE_HZ - first) * (after - before))


def _scene(pulse: Path, case: Case) -> Scene:
    radial = load_scene(find_scene("radial"), {"predictor": case.predictor})
    table = {"path": str(pulse), "rate": f"{RATE_HZ} Hz", "unit": "N", "repeat": "once"}
    source = RecordingScene.model_validate({"kind": "recording", **table})
    sensing = radial.sensing.model_copy(update={"source": source})
    return replace(radial, sensing=sensing, link=parse_link(case.link))
