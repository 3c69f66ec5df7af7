import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.scoring.heart_rate import heart_rate_per_min
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource


def pulse_n(duration_s: float, spacing_s: float = 1e-3, **table: object) -> NDArray[np.float64]:
    scene = SyntheticScene.model_validate({"kind": "synthetic"} | table)
    thin = round(spacing_s / 1e-3)
    return SyntheticSource(scene).take(round(duration_s * 1000))[::thin, 0]


def times_s(forces_n: NDArray[np.float64], spacing_s: float = 1e-3) -> NDArray[np.float64]:
    return 1234.5 + np.arange(len(forces_n)) * spacing_s


@pytest.mark.parametrize("spacing_s", [1e-3, 1e-2])
@pytest.mark.parametrize("preset", ["paper", "wide"])
@pytest.mark.parametrize("rate", [40, 75, 140, 180])
@pytest.mark.parametrize("noise", ["0 mN", "10 mN"])
def test_the_rate_of_a_pulse(rate: int, preset: str, noise: str, spacing_s: float) -> None:
    forces_n = pulse_n(6.0, spacing_s, preset=preset, heart_rate=f"{rate} /min", noise=noise)
    found = heart_rate_per_min(times_s(forces_n, spacing_s), forces_n)
    assert found == pytest.approx(rate, rel=0.02)


@pytest.mark.parametrize(
    ("seconds", "rate", "tolerance", "table"),
    [
        (1.9, 60, 0.02, {"heart_rate": "60 /min"}),
        (10, 75, 0.02, {"preset": "paper", "respiration": "25 %"}),
        (60, 60, 0.03, {"heart_rate_variability": "4 %", "heart_rate": "60 /min"}),
    ],
    ids=["two beats", "breathing", "variable beats"],
)
def test_the_rate_of_two_beats_with_breathing_and_of_variable_beats(
    seconds: float, rate: int, tolerance: float, table: dict[str, object]
) -> None:
    forces_n = pulse_n(seconds, **table)
    assert heart_rate_per_min(times_s(forces_n), forces_n) == pytest.approx(rate, rel=tolerance)


@pytest.mark.parametrize(
    "forces_n",
    [
        np.zeros(0), np.zeros(1), np.array([0.1, 0.5]), np.full(6000, 0.3), np.linspace(0, 1, 6000),
        pulse_n(0.5), np.append(pulse_n(6.0), np.nan),
    ], ids=["nothing", "one sample", "two samples", "flat", "a ramp", "one beat", "not felt now"],
)  # fmt: skip
def test_no_rate_without_two_beats_up_to_now(forces_n: NDArray[np.float64]) -> None:
    assert heart_rate_per_min(times_s(forces_n), forces_n) is None


def test_no_interval_spans_a_gap() -> None:
    forces_n = pulse_n(6.0, 1e-2)
    t_s = times_s(forces_n, 1e-2)
    # Cut for 4.6 s between two beats, as a link would: 13 /min if the gap were a beat.
    cut_s = np.where(np.arange(len(t_s)) > 100, t_s + 4.6, t_s)
    assert heart_rate_per_min(cut_s[:200], forces_n[:200]) is None
    assert heart_rate_per_min(cut_s, forces_n) == pytest.approx(75, rel=0.02)
    unknown_n = forces_n.copy()
    unknown_n[100:130] = np.nan
    assert heart_rate_per_min(t_s, unknown_n) == pytest.approx(75, rel=0.02)


@pytest.mark.parametrize("t_s", [np.zeros(100), -np.arange(100.0)], ids=["stands", "falls"])
def test_times_that_do_not_rise_have_no_rate(t_s: NDArray[np.float64]) -> None:
    assert heart_rate_per_min(t_s, np.sin(np.arange(100.0))) is None
