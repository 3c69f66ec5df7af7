import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from display_node.control.controller import HEADROOM, WORST_S, StallGuard, StepperController
from display_node.control.scene import ControllerScene
from display_node.plant.contact import ContactLaw
from display_node.plant.scene import FilmTable, StepperScene
from protocol.config.scene_file import find_scene
from telepulse.scene import load_scene
from tests.support.scene_loops import BEAT_S, PEAK_N, Host, press, stalls_always, stalls_at_times

TICK_S = 1e-3
LAW = ContactLaw(5e-3, 0.05e9 / 0.75, 1e3)
STEPPER = StepperScene.model_validate({"kind": "stepper", "max_speed": "1e15 m/s"})


def controller(**table: object) -> StepperController:
    scene = ControllerScene.model_validate({"kp": 0} | table)
    return StepperController(scene, STEPPER, LAW, FilmTable(), 2.5, TICK_S)


MILLIVOLTS_PER_NEWTON = 5305  # eq 21


@pytest.mark.parametrize(
    ("error", "expected", "response"),
    [
        ("force", 0.2, TICK_S * LAW.stiffness(0.3)),
        (
            "millivolts",
            0.2 * MILLIVOLTS_PER_NEWTON,
            TICK_S * LAW.stiffness(0.3) * MILLIVOLTS_PER_NEWTON,
        ),
        ("position", LAW.position(0.5) - LAW.position(0.3), TICK_S),
    ],
)
def test_the_error_is_in_the_scenes_unit(error: str, expected: float, response: float) -> None:
    output = controller(kp=2, error=error).output([0.9, 0.5], 0.3)
    # The gain acts on the error at the tick's end.
    assert output == pytest.approx(2 * (expected - response * output), rel=1e-4)
    at_rest = controller(kp=100, ki=10, kd=1, error=error)
    for _ in range(10):
        assert at_rest.output([0.4, 0.4], 0.4) == pytest.approx(0, abs=1e-9)


SCENES = ("radial", "real_bench", "tmcl_bench")


@pytest.mark.parametrize(
    "host",
    [lambda *_: 3, lambda _, at_s: 3 * (at_s > 1), stalls_always(6)],
    ids=["always", "suddenly", "1 to 6"],
)
def test_a_voltage_is_computed_for_the_time_for_which_it_is_held(host: Host) -> None:
    """Computed for one tick, the paper's actuator reaches tens of newtons, and swings on."""
    most_n, rmse_n = press(load_scene(find_scene("paper")).display, host, 5.0)
    assert 0.5 * PEAK_N < most_n < HEADROOM * PEAK_N
    assert rmse_n < 30e-3


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize(("longest_stall_ticks", "bar_mn"), [(6, 50.0), (20, 150.0), (45, 200.0)])
def test_repeated_stalls_do_not_press_far_beyond_the_pulse(
    name: str, longest_stall_ticks: int, bar_mn: float
) -> None:
    """Without the guard, the force reaches the limit, 2.5 N, and the RMSE exceeds 800 mN."""
    scene = load_scene(find_scene(name)).display
    most_n, rmse_n = press(scene, stalls_always(longest_stall_ticks), 20.0)
    assert 0.5 * PEAK_N < most_n < HEADROOM * PEAK_N
    assert rmse_n < bar_mn * 1e-3


@pytest.mark.parametrize("name", SCENES)
def test_the_first_stalls_after_quiet_time_add_at_most_the_beats_own_rise(name: str) -> None:
    scene = load_scene(find_scene(name)).display
    most_n, _ = press(scene, stalls_at_times(45), 14.0)
    rise_n = PEAK_N * math.pi / BEAT_S * 45 * scene.tick_ns * 1e-9
    assert most_n < HEADROOM * PEAK_N + rise_n


def test_a_host_without_stalls_is_not_slowed(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = load_scene(find_scene("radial")).display
    guarded = press(scene, stalls_always(0), 3.0)
    monkeypatch.setattr(StallGuard, "tick", lambda *_: None)
    assert guarded == press(scene, stalls_always(0), 3.0)


@given(st.floats(0.05, 2.0), st.floats(0.0, 1.0), st.integers(2, 100), st.integers(0, 5000))
def test_a_speed_held_for_the_longest_recent_stall_ends_at_the_headroom(
    peak_n: float, share: float, ticks: int, later_ticks: int
) -> None:
    guard = StallGuard(LAW, TICK_S, 0.0)
    guard.tick(ticks, peak_n)
    for _ in range(later_ticks):
        guard.tick(0, peak_n)
    screw_m = LAW.position(share * peak_n)
    remembered_s = (ticks + 1) * TICK_S * math.exp(-later_ticks * TICK_S / WORST_S)
    if remembered_s < 2 * TICK_S:
        assert guard.fastest(screw_m) == math.inf
    else:
        reached_n = LAW.force(screw_m + guard.fastest(screw_m) * remembered_s)
        assert reached_n == pytest.approx(HEADROOM * peak_n, rel=1e-6)


def test_beyond_the_headroom_the_tip_only_retracts_and_backlash_is_taken_up_before_touch() -> None:
    guard = StallGuard(LAW, TICK_S, 0.0)
    guard.tick(10, 0.5)
    assert guard.fastest(LAW.position(0.7)) == 0.0
    guard = StallGuard(LAW, TICK_S, 1e-5)
    guard.tick(9, 0.0)
    assert guard.fastest(0.0) == pytest.approx(1e-5 / 10e-3)
