"""The choice of the perceived delay E: "auto" beside "shape" and constants, on pulses of people.

Every pulse has a height of 0.3 N on a static force of 0.75 N, and is played over each link. What is
felt from 25 to 45 s after the start is compared with the pulse at that time (in phase), and with
the pulse E earlier (aligned), as it was before the sensor's noise. An aligned error of more than a
tenth of the pulse's height is noticed. The regret is the error in phase of "auto" over that of the
best constant E in hindsight: the least error of those that are noticed for at most the scene's
`noticed_target`; where there is none, that of the one which is noticed least.
"""

import math
import statistics
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.benchmark import Benchmark
from display_node.prediction.grid import STEP_NS as CELL_NS
from display_node.prediction.path_errors import BLENDED
from display_node.prediction.trust import HORIZONS, STEP_NS
from protocol.config.scene_file import find_scene
from protocol.tactile import JND
from protocol.ticks import TickState
from sensing_node.scene import build_source
from sensing_node.sources.recorded import RecordingScene
from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import STREAM_BEGINS_NS, Simulation
from tests.support.drawn_pulses import Pulse
from tests.support.people_pulses import people_pulses

Floats = NDArray[np.float64]
SEED: Final = 1
FROM_S, UNTIL_S = 25.0, 45.0
HEIGHT_N, STATIC_N = 0.3, 0.75
RADIAL: Final = "radial"
LINKS: Final = {
    "10 ± 2 ms": "delay=10ms,jitter=2ms",
    "40 ± 10 ms, 1 %": "delay=40ms,jitter=10ms,loss=1%",
    "100 ± 20 ms, 1 %": "delay=100ms,jitter=20ms,loss=1%",
    "stalls of 300 ms": "delay=40ms,jitter=10ms,stall.for=300ms,stall.every=20s",
    "wandering by 30 ms": "delay=40ms,jitter=5ms,wander.by=30ms,wander.over=2s",
}
CONSTANT: Final = tuple(f"{each} ms" for each in (0, 10, 20, 30, 45, 60, 90, 130))
AUTO, SHAPE, AT_ONCE = "auto", "shape", CONSTANT[0]
SETTINGS: Final = (AUTO, SHAPE, *CONSTANT)
# Horizons at which expected and actual errors are compared, in steps of 10 ms.
JUDGED_STEPS: Final = (2, 5, 10)
# Half of the time over which the pulse's height is measured, in steps of 10 ms.
HALF_SPAN_STEPS: Final = 200


class Played(NamedTuple):
    """A pulse in N without noise, and the keys of the recording that is sensed.

    source: empty for the scene's own pulse.
    """

    name: str
    source: Mapping[str, object]
    true_n: Floats
    rate_hz: float


class Case(NamedTuple):
    """A pulse over a link with a setting of `compensation`."""

    pulse: Played
    link: str
    setting: str

    def __str__(self) -> str:
        return f"{self.pulse.name} over {self.link} with {self.setting}"


class Score(NamedTuple):
    """Mean E in ms, RMS errors in mN, and the share of the time in which a finger notices one.

    judged: of each of `JUDGED_STEPS`, the expected RMS error over the actual one, and the expected
    and the actual share of the time noticed; NaN where nothing was predicted so far ahead.
    """

    delay_ms: float
    in_phase_mn: float
    aligned_mn: float
    noticed: float
    judged: tuple[tuple[float, float, float], ...]


def main(benchmark: Benchmark) -> None:
    """Print a table for each link, the choice's regret, and the judgement of the judge."""
    with tempfile.TemporaryDirectory() as folder:
        pulses = list(_all_pulses(benchmark, Path(folder)))
        pulses = [each for each in pulses if each.name in benchmark.choose(p.name for p in pulses)]
        links = LINKS
        settings = SETTINGS
        if benchmark.quick:
            pulses, links, settings = pulses[:2], dict(list(LINKS.items())[:1]), SETTINGS[:4]
        cases = [
            Case(pulse, link, setting) for pulse in pulses for link in links for setting in settings
        ]
        scores = dict(zip(_keys(cases), benchmark.run(score, cases), strict=True))
    target = load_scene(find_scene(RADIAL)).display.noticed_target
    regrets, excesses = [], []
    for link in links:
        rows = []
        for pulse in pulses:
            found = {setting: scores[pulse.name, link, setting] for setting in settings}
            best = _best(found, target)
            auto = found[AUTO]
            least = min(each.noticed for name, each in found.items() if name in CONSTANT)
            regrets.append(auto.in_phase_mn / found[best].in_phase_mn)
            excesses.append(auto.noticed - max(target, least))
            rows.append(
                (
                    pulse.name,
                    *(_cell(found[each]) for each in (AUTO, SHAPE, AT_ONCE)),
                    f"{best}: {_cell(found[best])}",
                    f"{regrets[-1]:.2f}",
                )
            )
        benchmark.table(
            f"{link}: E in ms, error in phase in mN, share of the time noticed",
            ("pulse", '"auto"', '"shape"', "E = 0", "best constant", "regret"),
            rows,
        )
    _show_headline(benchmark, pulses, links, scores)
    _show_judge(benchmark, scores)
    benchmark.judge("regret, median", statistics.median(regrets))
    benchmark.judge("regret, worst", max(regrets))
    benchmark.judge("time noticed beyond the target, worst", max(excesses))


def _keys(cases: list[Case]) -> list[tuple[str, str, str]]:
    return [(case.pulse.name, case.link, case.setting) for case in cases]


def _best(found: Mapping[str, Score], target: float) -> str:
    """Return the best constant E in hindsight."""
    constants = [name for name in found if name in CONSTANT]
    within = [name for name in constants if found[name].noticed <= target]
    if within:
        return min(within, key=lambda name: found[name].in_phase_mn)
    return min(constants, key=lambda name: found[name].noticed)


def _cell(score: Score) -> str:
    return f"{score.delay_ms:z.0f}, {score.in_phase_mn:.1f}, {score.noticed:.1%}"


def _show_headline(
    benchmark: Benchmark,
    pulses: list[Played],
    links: Mapping[str, str],
    scores: Mapping[tuple[str, str, str], Score],
) -> None:
    """Print the errors in phase under "auto" of the median person, the worst, and `radial`."""
    people = [each.name for each in pulses if each.name != RADIAL] or [RADIAL]
    rows = []
    for link in links:
        found = {name: scores[name, link, AUTO] for name in {*people, RADIAL}}
        order = sorted(people, key=lambda name: found[name].in_phase_mn)
        worst = order[-1]
        errors = [1e-3 * found[name].in_phase_mn / HEIGHT_N for name in order]
        delays = [found[name].delay_ms for name in order]
        rows.append(
            (
                link,
                f"{statistics.median(errors):.1%}, E {statistics.median(delays):z.0f} ms",
                f"{errors[-1]:.1%}, E {found[worst].delay_ms:z.0f} ms ({worst})",
                f"{1e-3 * found[RADIAL].in_phase_mn / HEIGHT_N:.1%},"
                f" E {found[RADIAL].delay_ms:z.0f} ms",
            )
        )
    benchmark.table(
        f'Error in phase over the pulse\'s height under "auto", {len(people)} people',
        ("link", "median", "worst", RADIAL),
        rows,
    )


def _show_judge(benchmark: Benchmark, scores: Mapping[tuple[str, str, str], Score]) -> None:
    """Print the expected over the actual errors at E = 0, by horizon."""
    rows, ratios, shares = [], [], []
    for number, steps in enumerate(JUDGED_STEPS):
        judged = [
            score.judged[number] for (*_, setting), score in scores.items() if setting == AT_ONCE
        ]
        errors = [ratio for ratio, _, _ in judged if np.isfinite(ratio)]
        # Below half a percent both are as good as none.
        factors = [
            max(expected, 0.005) / max(actual, 0.005)
            for ratio, expected, actual in judged
            if np.isfinite(ratio)
        ]
        ratios += errors
        shares += factors
        rows.append(
            (
                f"{steps * STEP_NS // 1_000_000} ms",
                *(f"{each:.2f}" for each in np.quantile(errors or [np.nan], (0.5, 0.1, 0.9))),
                *(f"{each:.2f}" for each in np.quantile(factors or [np.nan], (0.5, 0.1, 0.9))),
            )
        )
    benchmark.table(
        "Expected over actual at E = 0: median, and from the lowest to the highest tenth",
        ("horizon", "RMS error", "10 %", "90 %", "time noticed", "10 %", "90 %"),
        rows,
    )
    benchmark.judge("expected over actual RMS error, median", statistics.median(ratios or [1.0]))
    benchmark.judge("expected over actual time noticed, median", statistics.median(shares or [1.0]))


def score(case: Case) -> Score:
    """Play a case."""
    simulation = Simulation(_scene(case), SEED)
    contactor = simulation.display.contactors[0]
    ticks: list[tuple[float, float, float, float]] = []
    expected: list[tuple[Floats, Floats]] = []

    def watch(tick: TickState) -> None:
        felt_s = (tick.now_ns - STREAM_BEGINS_NS) * 1e-9
        if felt_s < UNTIL_S:
            ticks.append((felt_s, tick.playout_delay_ns * 1e-9, tick.felt_n, tick.predicted_ns))
            errors = contactor.expected
            if errors is not None and case.setting == AT_ONCE:
                expected.append((errors.in_phase_n2[:, 0], errors.noticed))

    simulation.run(UNTIL_S + 0.6, FROM_S, watch)
    now_s, delay_s, felt_n, predicted_ns = np.array(ticks).T
    t_s = np.arange(len(case.pulse.true_n)) / case.pulse.rate_hz
    present_n, played_n = (
        np.interp(at_s, t_s, case.pulse.true_n) for at_s in (now_s, now_s - delay_s)
    )
    aligned_n = felt_n - played_n
    noticed = np.abs(aligned_n) > JND * _heights_n(case.pulse, now_s)
    judged = [_judge(expected, aligned_n, noticed, predicted_ns, steps) for steps in JUDGED_STEPS]
    in_phase_mn, aligned_mn = (
        1e3 * float(np.sqrt(np.mean(error_n**2))) for error_n in (felt_n - present_n, aligned_n)
    )
    mean_ms = 1e3 * float(delay_s.mean())
    return Score(mean_ms, in_phase_mn, aligned_mn, float(noticed.mean()), tuple(judged))


def _judge(
    expected: list[tuple[Floats, Floats]],
    error_n: Floats,
    noticed: NDArray[np.bool_],
    predicted_ns: Floats,
    steps: int,
) -> tuple[float, float, float]:
    """Compare what was expected with what was felt, of ticks about so many steps ahead."""
    ahead = np.abs(predicted_ns - steps * STEP_NS) < STEP_NS
    if not expected or np.count_nonzero(ahead) < 500:
        return np.nan, np.nan, np.nan
    horizon = BLENDED * (steps + CELL_NS / 2 / STEP_NS)
    squares_n2, share = (
        float(np.interp(horizon, np.arange(HORIZONS + 1), np.mean(each, axis=0)))
        for each in zip(*expected, strict=True)
    )
    actual_n = float(np.sqrt(np.mean(error_n[ahead] ** 2)))
    return math.sqrt(squares_n2) / actual_n, share, float(noticed[ahead].mean())


def _heights_n(pulse: Played, at_s: Floats) -> Floats:
    """Return the pulse's peak to peak in the 4 s around each time."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d

    grid_s = np.arange(0, len(pulse.true_n) / pulse.rate_hz, 1e-9 * STEP_NS)
    true_n = np.interp(grid_s, np.arange(len(pulse.true_n)) / pulse.rate_hz, pulse.true_n)
    size = 2 * HALF_SPAN_STEPS + 1
    heights_n = maximum_filter1d(true_n, size) - minimum_filter1d(true_n, size)
    return np.asarray(np.interp(at_s, grid_s, heights_n))


def _scene(case: Case) -> Scene:
    radial = load_scene(find_scene(RADIAL), {"compensation": case.setting})
    scene = replace(radial, link=parse_link(LINKS[case.link]))
    if not case.pulse.source:
        return scene
    source = RecordingScene.model_validate({"kind": "recording", **case.pulse.source})
    return replace(scene, sensing=scene.sensing.model_copy(update={"source": source}))


def _all_pulses(benchmark: Benchmark, folder: Path) -> Iterator[Played]:
    """Yield `radial`, the pulses of people, and the recordings of `--records`."""
    radial = load_scene(find_scene(RADIAL))
    samples = round(1_000 * (UNTIL_S + 1))
    true_n = build_source(radial.sensing, radial.path.parent).take(samples)[:, 0]
    yield Played(RADIAL, {}, true_n, 1_000.0)
    for number, pulse in enumerate(people_pulses(UNTIL_S + 2, SEED)):
        # Of a recording that is shorter, nothing is scored.
        if len(pulse.sensed) > UNTIL_S * pulse.rate_hz:
            yield _written(pulse, folder / f"{number}.npy")
    if benchmark.records is not None:
        for path in sorted(benchmark.records.iterdir()):
            yield _recorded(path)


def _written(pulse: Pulse, path: Path) -> Played:
    """Write a pulse in N for a recording's source."""
    low, high = np.percentile(pulse.true[round(5 * pulse.rate_hz) :], [0.5, 99.5])
    scale_n = HEIGHT_N / (high - low)
    sensed_n, true_n = (
        STATIC_N + scale_n * (each - (low + high) / 2) for each in (pulse.sensed, pulse.true)
    )
    np.save(path, sensed_n)
    source = {"path": str(path), "rate": f"{pulse.rate_hz} Hz", "unit": "N", "repeat": "once"}
    return Played(pulse.name, source, true_n, pulse.rate_hz)


def _recorded(path: Path) -> Played:
    """Read a recording as a scene does, with the height of its usual beat."""
    source = {"path": str(path)}
    scene = _scene(Case(Played(path.stem, source, np.empty(0), 1.0), next(iter(LINKS)), AUTO))
    pulse = build_source(scene.sensing, Path())
    rate_hz = 1e9 / pulse.period_ns
    return Played(path.stem, source, pulse.take(round(rate_hz * (UNTIL_S + 1)))[:, 0], rate_hz)
