import os

import pytest

from protocol.errors import SceneError
from telepulse.reports.studies.sweep import THREADS, in_one_thread
from telepulse.scene import find_scene


def test_the_function_runs_elsewhere_with_one_thread_and_our_environment_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv(THREADS, raising=False)
    assert in_one_thread(os.getenv, THREADS) == "1"
    assert THREADS not in os.environ
    monkeypatch.setenv(THREADS, "3")
    assert in_one_thread(os.getenv, THREADS) == "1"
    assert os.environ[THREADS] == "3"


def test_what_it_raises_is_raised_here() -> None:
    with pytest.raises(SceneError, match="no such scene"):
        in_one_thread(find_scene, "nowhere")
