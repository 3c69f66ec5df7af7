import numpy as np
import pytest

from protocol.config.scene_file import find_scene
from telepulse.reports.paper import experiment
from telepulse.reports.paper.experiment import TrackingRun
from telepulse.scene import load_scene


@pytest.fixture(scope="module")
def run() -> TrackingRun:
    return experiment.run(load_scene(find_scene("paper")))


def test_it_is_the_first_6_s_of_the_scenes_pulse(run: TrackingRun) -> None:
    assert len(run.t_s) == len(run.wanted_n) == len(run.felt_n) == 6000
    assert run.t_s[-1] == pytest.approx(5.999)
    assert 0.3 < np.ptp(run.wanted_n) < 0.45


def test_it_follows_to_its_lag(run: TrackingRun) -> None:
    assert run.force_rmse_n == pytest.approx(1.7e-3, rel=0.1)
    assert run.force_rmse_n == pytest.approx(
        float(np.sqrt(np.mean((run.felt_n - run.wanted_n) ** 2)))
    )


def test_it_has_settled_before_the_pulse(run: TrackingRun) -> None:
    assert abs(run.felt_n[:20] - run.wanted_n[:20]).max() < 0.2e-3
