from itertools import pairwise
from pathlib import Path

import pytest

from protocol.errors import SceneError
from telepulse.experiment.session import draw_trials, load_plan
from telepulse.simulation.link_scene import LinkScene
from tests.support.experiment_sessions import condition, plan, write
from tests.support.refusals import refusal_of


def test_a_condition_has_its_own_link_and_playout_and_direct_has_none(tmp_path: Path) -> None:
    found = plan(tmp_path, condition("a", compensation="20 ms"), condition("b", "delay=7ms"))
    assert found.direct.link == LinkScene()
    assert found.direct.display.compensation_ns == "auto"
    assert found.impaired["a"].display.compensation_ns == 20_000_000
    assert found.impaired["b"].link.delay_ns == 7_000_000
    assert found.impaired["b"].display.controller == found.direct.display.controller


@pytest.mark.parametrize(
    ("keys", "conditions", "reason"),
    [
        ({"trails": 3}, (), "trails: unknown key; did you mean trials?"),
        ({"trials": 0}, (), "trials: must be greater than or equal to 1, got 0"),
        ({}, (condition("a"), condition("a")), "two conditions have the name 'a'"),
        ({}, (condition("a", "delay=40"),), "conditions.0.link: "),
        ({}, (condition("a", compensation="soon"),), "'a': compensation: "),
        ({"scene": "nowhere"}, (), "nowhere: no such scene; known by name: "),
    ],
)
def test_a_wrong_session_file_is_refused_in_one_line(
    tmp_path: Path, keys: dict[str, object], conditions: tuple[str, ...], reason: str
) -> None:
    path = write(tmp_path / "s.toml", *conditions, **keys)
    assert reason in refusal_of(SceneError, load_plan, path)


def test_the_example_can_be_run(tmp_path: Path) -> None:
    example = Path(__file__).parents[4] / "telepulse" / "experiment" / "example.toml"
    assert len(load_plan(example).session.conditions) == 4


def test_each_condition_has_its_trials_in_an_order_that_the_seed_gives(tmp_path: Path) -> None:
    session = plan(tmp_path, condition("a"), condition("b"), trials=20, catch=5).session
    trials = draw_trials(session, 1)
    names = [trial.condition for trial in trials]
    assert [names.count(name) for name in ("a", "b", None)] == [20, 20, 5]
    assert names != sorted(names, key=str)
    assert trials == draw_trials(session, 1) != draw_trials(session, 2)


def test_x_does_not_depend_on_earlier_trials(tmp_path: Path) -> None:
    trials = draw_trials(plan(tmp_path, trials=4_000).session, 1)
    for field in ("x", "direct"):
        drawn = [getattr(trial, field) == "A" for trial in trials]
        again = [one == other for one, other in pairwise(drawn)]
        # Four standard deviations of a coin.
        assert abs(sum(drawn) - 2_000) < 4 * 32
        assert abs(sum(again) - 2_000) < 4 * 32


def test_a_catch_trial_has_no_link_and_a_rating_has_an_open_reference(tmp_path: Path) -> None:
    for kind in ("abx", "rating"):
        for trial in draw_trials(plan(tmp_path, kind=kind, catch=3, trials=20).session, 1):
            link = [trial.on_link(letter) for letter in ("A", "B")]
            if trial.condition is None:
                assert not any(link)
                assert not trial.on_link("X")
            elif kind == "rating":
                assert not trial.on_link("A")
                assert trial.on_link("X")
            else:
                assert link.count(True) == 1
                assert trial.on_link("X") == trial.on_link(trial.x)
