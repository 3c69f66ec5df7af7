import numpy as np
import pytest

from protocol.config.scene_file import find_scene
from telepulse.reports.paper.stepper import run_scene
from telepulse.scene import load_scene


def test_the_papers_pulse_is_followed_for_6_s_from_a_settled_finger() -> None:
    run = run_scene(load_scene(find_scene("paper")))
    assert len(run.t_s) == len(run.wanted_n) == len(run.felt_n) == 6000
    assert run.t_s[-1] == pytest.approx(5.999)
    assert 0.3 < np.ptp(run.wanted_n) < 0.45
    off_n = run.felt_n - run.wanted_n
    assert abs(off_n[:20]).max() < 0.2e-3
    assert run.force_rmse_n == pytest.approx(1.7e-3, rel=0.1)
    assert run.force_rmse_n == pytest.approx(float(np.sqrt(np.mean(off_n**2))))
