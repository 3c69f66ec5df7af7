"""Several contactors: what each further one costs, how far apart they are, how well predicted.

The costs are processor time of ticks and frames, in turns; the first contactor's is 1.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.benchmark import Benchmark
from display_node.prediction.channel_path import ChannelPath
from display_node.prediction.ensemble import Ensemble
from protocol.config.scene_file import find_scene
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource
from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation
from tests.support.contactor_lags import lags_ms

LINK = "delay=40ms,jitter=10ms,loss=1%"
ROUNDS, SECONDS = 8, 12.0
# Ticks whose cost is compared.
SLICE = 100
LAG_SECONDS, SETTLE_SECONDS = 25.0, 10.0
MS = 1_000_000
HORIZONS_MS = (20, 50, 100, 200)
LEARNT_MS, PULSE_MS, FRAME = 20_000, 60_000, 5
# All vary by 4 %, with noise of 0.5 mN where none is given.
PULSES: dict[str, dict[str, Any]] = {
    "varying": {},
    "ectopic": {"ectopic": "10 %"},
    "noisy": {"noise": "10 mN"},
}
POSITIONS = [
    {"name": "2.5 cm on", "distance": "2.5 cm"},
    {"name": "5 cm on", "distance": "5 cm", "peak_to_peak": "0.2 N"},
    {"name": "another shape", "preset": "paper"},
]


def fingers(count: int, predictor: str, link: str = LINK) -> Scene:
    """Return the scene of three fingers with its first contactors, or more, over a link.

    More than three are at places of their own, 5 mm apart.
    """
    changes: dict[str, Any] = {"display": {"predictor": predictor}}
    if count > 3:
        places = [{"name": f"place {at}", "distance": f"{5 * at} mm"} for at in range(count)]
        changes["sensing"] = {"source": {"position": places}}
        changes["display"]["contactor"] = [{"channel": place["name"]} for place in places]
    scene = load_scene(find_scene("three_fingers"), **changes)
    several = scene.display.model_copy(update={"contactor": scene.display.contactor[:count]})
    display = several if count > 1 else several.contactors[0]
    return replace(scene, display=display, link=parse_link(link))


def tick_costs_us(scene: Scene) -> np.ndarray:
    """Return the processor time of a tick with its share of the frames, in µs, of each slice."""
    simulation, spent_ns = Simulation(scene, seed=1), Counter[int]()

    def timed(call: Callable[..., Any]) -> Callable[..., Any]:
        def called(*arguments: Any) -> Any:
            place, began_ns = display.ticks // SLICE, time.process_time_ns()
            result = call(*arguments)
            spent_ns[place] += time.process_time_ns() - began_ns
            return result

        return called

    display = simulation.display
    display.tick, display.on_frame = (  # type: ignore[method-assign]
        timed(display.tick),
        timed(display.on_frame),
    )
    simulation.run(SECONDS)
    return np.array([spent_ns[place] for place in range(display.ticks // SLICE)]) * 1e-3 / SLICE


def cost_row(benchmark: Benchmark, predictor: str) -> tuple[str, ...]:
    """Return the cost of the first contactor, and over it that of further ones: 2, 3, 4 to 8."""
    found: dict[int, list[np.ndarray]] = {count: [] for count in (1, 2, 3, 8)}
    for _ in range(1 if benchmark.quick else ROUNDS):
        for count, costs in found.items():
            costs.append(tick_costs_us(fingers(count, predictor)))
    # Of each slice, the least of the rounds, which compute the same: other load only adds.
    one, two, three, eight = (float(np.min(costs, axis=0).mean()) for costs in found.values())
    shares = (two - one) / one, (three - two) / one, (eight - three) / (5 * one)
    benchmark.judge(f"a further contactor's tick over the first one's, {predictor}", max(shares))
    return predictor, f"{one:.0f} µs", *(f"{share:.2f}" for share in shares)


def skew_row(predictor: str, link: str) -> tuple[tuple[str, ...], float]:
    """Return the row of each contactor's lag behind the played instant, and the skew in s."""
    found = lags_ms(fingers(3, predictor, link), LAG_SECONDS, SETTLE_SECONDS)
    lags = ", ".join(f"{lag:.3f}" for lag in found)
    skew_ms = max(found) - min(found)
    return (link, predictor, lags, f"{skew_ms:.3f} ms"), skew_ms * 1e-3


def nrmse(predictors: Iterable[ChannelPath], pulses_n: np.ndarray) -> np.ndarray:
    """Return the error over the deviation, shape (channels, horizons)."""
    predictors = list(predictors)
    squares = np.zeros((len(predictors), len(HORIZONS_MS)))
    for first in range(0, PULSE_MS - max(HORIZONS_MS) - FRAME, FRAME):
        times_ns = [(first + number) * MS for number in range(FRAME)]
        for predictor, pulse_n in zip(predictors, pulses_n.T, strict=True):
            predictor.observe(times_ns, pulse_n[first : first + FRAME].tolist())
        for _ in range(FRAME):
            for predictor in predictors:
                predictor.work()
        if first < LEARNT_MS:
            continue
        for row, (predictor, pulse_n) in enumerate(zip(predictors, pulses_n.T, strict=True)):
            for column, ahead_ms in enumerate(HORIZONS_MS):
                at = first + FRAME - 1 + ahead_ms
                squares[row, column] += (predictor.predict(at * MS) - pulse_n[at]) ** 2
    steps = (PULSE_MS - max(HORIZONS_MS) - FRAME - LEARNT_MS) // FRAME
    deviations: np.ndarray = pulses_n.std(axis=0)[:, np.newaxis]
    return np.asarray(np.sqrt(squares / steps) / deviations)


def prediction_rows(name: str) -> list[tuple[str, ...]]:
    """Return the errors of channels predicted with the first one, and by a predictor each."""
    table = {
        "kind": "synthetic",
        "heart_rate_variability": "4 %",
        "respiration": "10 %",
        "noise": "0.5 mN",
        "position": [{"name": "first"}, *POSITIONS],
    }
    scene = SyntheticScene.model_validate(table | PULSES[name])
    pulses_n = SyntheticSource(scene).take(PULSE_MS)
    ensemble = Ensemble("stack", len(POSITIONS) + 1)
    together = nrmse([ensemble, *ensemble.others], pulses_n)
    alone = nrmse([Ensemble("stack") for _ in range(len(POSITIONS) + 1)], pulses_n)
    rows = zip(POSITIONS, together[1:], alone[1:], strict=True)
    return [
        (name, place["name"], *(f"{a:.3f} / {b:.3f}" for a, b in zip(both, own, strict=True)))
        for place, both, own in rows
    ]


def main(benchmark: Benchmark) -> None:
    """Print the three tables."""
    columns = ("predictor", "first contactor", "second", "third", "fourth to eighth, each")
    rows = [cost_row(benchmark, predictor) for predictor in ("stack", "linear")]
    benchmark.table(
        f"Processor time of a tick over {LINK}, of further contactors over the first", columns, rows
    )
    links = ("delay=0ms", LINK)
    skews = [skew_row(predictor, link) for link in links for predictor in ("linear", "stack")]
    title = "Lag of each contactor behind the instant that is played, in ms, and the skew"
    benchmark.table(
        title, ("link", "predictor", "cun, guan, chi", "skew"), [row for row, _ in skews]
    )
    benchmark.judge("skew between contactors", max(skew_s for _, skew_s in skews))
    found = [row for name in PULSES for row in prediction_rows(name)]
    horizons = [f"{ahead} ms" for ahead in HORIZONS_MS]
    title = "NRMSE of a further channel: predicted with the first one / by its own predictor"
    benchmark.table(title, ("pulse", "channel", *horizons), found)
