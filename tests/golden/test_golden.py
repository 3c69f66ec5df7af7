"""Figures, keys, metrics and schemas are the same as before."""

import json
from typing import Any

import pytest

from tests.golden.__main__ import figures, read
from tests.golden.comparison import differences
from tests.golden.runs import SCENES, SEEDS, run


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("scene", SCENES)
def test_a_simulated_run_gives_the_same_figures(scene: str, seed: int) -> None:
    golden = read("summaries")[f"{scene} {seed}"]
    assert differences(run(scene, seed), golden) == {}


@pytest.mark.parametrize(
    "change",
    [
        {"display": {"actuator": {"fingertip": "1.0001 N/mm"}}},
        {"sensing": {"source": {"peak_to_peak": "0.30003 N"}}},
    ],
    ids=["fingertip", "sensor"],
)
def test_a_gain_that_is_off_by_a_ten_thousandth_shows(change: dict[str, Any]) -> None:
    found = differences(run("radial", 1, **change), read("summaries")["radial 1"])
    assert found["force_rmse_n.aligned"] > 1e-6


def test_keys_metrics_and_schemas_are_the_same() -> None:
    golden, now = read("figures"), json.loads(json.dumps(figures()))
    assert now == golden
    assert list(now["summary"]) == list(golden["summary"])
