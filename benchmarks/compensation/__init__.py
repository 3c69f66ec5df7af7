"""Roughness, learning, and errors of a predicted pulse beside those of a buffered one."""

from dataclasses import replace
from unittest.mock import patch

from benchmarks.benchmark import Benchmark
from benchmarks.compensation.learning import show_learning
from benchmarks.compensation.trust import show_trust
from display_node.prediction import PredictorName
from display_node.prediction.scene import own_predictor
from protocol.config.scene_file import find_scene
from protocol.summary.tables import Summary
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation

SETTLE_S, SCORED_S = 28.0, 12.0
SETTLE_AUTO_S = 45.0
LINKS = {
    "20±3 ms, 1 % loss": "delay=20ms,jitter=3ms,loss=1%",
    "40±10 ms": "delay=40ms,jitter=10ms",
    "tcp stalls": "delay=40ms,loss=1%,transport=tcp",
}
CASES: tuple[tuple[PredictorName, int], ...] = (
    ("stack", 5),
    ("stack", 10),
    ("linear", 5),
    ("hold", 5),
)


def main(benchmark: Benchmark) -> None:
    """Print the tables."""
    show_learning(benchmark)
    _show_all_predicted(benchmark)
    _show_auto(benchmark)
    show_trust(benchmark, LINKS)


def _show_all_predicted(benchmark: Benchmark) -> None:
    rows = []
    for name, link in LINKS.items():
        for predictor, batch_ms in CASES:
            smooth = _played(link, predictor, 0, batch_ms)
            with patch("display_node.prediction.concealment.DECAY_OVER_HORIZON", 0.0):
                rough = _played(link, predictor, 0, batch_ms)
            rows.append((name, f"{batch_ms} ms", predictor, *_figures(rough), *_figures(smooth)))
    benchmark.table(
        "radial at E = 0: energy above 25 Hz over the sensed one's, RMSE in phase in mN",
        ("link", "frames", "predictor", "energy", "RMSE", "smoothed: energy", "RMSE"),
        rows,
    )


def _show_auto(benchmark: Benchmark) -> None:
    chosen = []
    for name, link in LINKS.items():
        for predictor, _ in (CASES[2], CASES[0]):
            auto = _played(link, predictor, None, 5)
            share, delay_ms = auto.compensation.trusted, auto.playout_delay_ms.mean
            trusted = "–" if share is None else f"{share:.2f}"
            chosen.append((name, predictor, trusted, f"{delay_ms or 0:.1f}", *_figures(auto)))
    benchmark.table(
        "radial at E = auto: of the whole run the share trusted and the mean E; then as above",
        ("link", "predictor", "trusted", "E in ms", "energy", "RMSE"),
        chosen,
    )


def _played(
    link: str, predictor: PredictorName, compensation_ns: int | None, batch_ms: int
) -> Summary:
    radial = load_scene(find_scene("radial"))
    changes = {"predictor": own_predictor(predictor), "compensation_ns": compensation_ns}
    scene = replace(
        radial,
        sensing=radial.sensing.model_copy(update={"batch_ns": batch_ms * 1_000_000}),
        display=radial.display.model_copy(update=changes),
        link=parse_link(link),
    )
    settle_s = SETTLE_AUTO_S if compensation_ns is None else SETTLE_S
    return Simulation(scene, seed=1).run(settle_s + SCORED_S, settle_s)


def _figures(summary: Summary) -> tuple[str, str]:
    energy, error_n = summary.roughness.energy_ratio, summary.force_rmse_n.in_phase
    assert energy is not None
    assert error_n is not None
    return f"{energy:.2f}", f"{error_n * 1e3:.2f}"
