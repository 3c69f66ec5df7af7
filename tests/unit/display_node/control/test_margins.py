import math
from pathlib import Path

import control
import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.control.linear_loop import (
    FORCE_SHARES,
    LinearLoop,
    felt_noise,
    margins,
    refuse_unstable,
)
from display_node.scene import DisplayScene
from protocol.config.scene import load_section
from protocol.errors import SceneError
from tests.support.force_loops import FINE, LAYER, LIMIT_N, TICK_S, Case, Shipped, Table

SCENES = Path(__file__).parents[4] / "scenes"
NYQUIST_RAD_PER_S = math.pi / TICK_S
POSITION: Table = {"error": "position", "kp": 100}
OBSERVED = POSITION | {"feed_forward": True, "observer": {"wander": "0.1 mm", "softening": 0}}
ROTOR = FINE | {"rotor_resonance": "100 Hz"}
SLOW: Table = {"filter": "40 Hz", "noise": "2 mN"}
CASES = {
    "film": Case(POSITION | {"kp": 50}, FINE, SLOW | {"filter_order": 2}),
    "rotor": Case(POSITION | {"kp": 50}, ROTOR),
    "rotor and film": Case(POSITION | {"kp": 30}, ROTOR, SLOW),
    "observer": Case(OBSERVED, ROTOR, SLOW),
}
every_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())


def looped(z_domain: control.TransferFunction) -> LinearLoop:
    """A textbook loop: negative feedback of 1 round a transfer function of z."""
    system = control.ss(z_domain)
    a, b, c = system.A, system.B[:, 0], system.C[0]
    nothing = np.zeros(len(a))
    return LinearLoop(TICK_S, a, b, -c, nothing, -1.0, c, displaced=nothing)


def tf(num: list[float], den: list[float]) -> control.TransferFunction:
    return control.tf(num, den, TICK_S)


def sampled(num: list[float], den: list[float]) -> control.TransferFunction:
    return control.c2d(control.tf(num, den), TICK_S)


TEXTBOOK = {
    "integrator and delay": tf([0.05], [1, -1, 0, 0, 0]),
    "third order": sampled([4e4], [1, 60, 1100, 6000]),
    "double integrator and lead": tf([0.004, -0.0037], [1, -2, 1, 0]),
    "resonance": sampled([2e6], [1, 40, 1e5, 0]),
    "PI on a lag": tf([0.08, -0.0799], [1, -1]) * sampled([20], [1, 20]) * tf([1], [1, 0, 0]),
    "fast": tf([0.4], [1, -0.7, -0.1, 0]),
}


@pytest.mark.parametrize("system", TEXTBOOK.values(), ids=TEXTBOOK.keys())
def test_margins_are_those_of_python_control(system: control.TransferFunction) -> None:
    w = np.geomspace(NYQUIST_RAD_PER_S * 1e-5, NYQUIST_RAD_PER_S * 0.9999, 2500)
    response = system(np.exp(1j * w * TICK_S))
    dense = (np.abs(response), np.degrees(np.unwrap(np.angle(response))), w)
    gain, phase_deg, nearest, _, gain_cut, _ = control.stability_margins(dense)
    found = margins(looped(system))
    assert found.gain == pytest.approx(gain, rel=1e-3)
    assert found.phase_deg == pytest.approx(phase_deg, abs=0.02)
    # As exact as the step from one frequency to the next.
    assert found.delay_s == pytest.approx(math.radians(phase_deg) / gain_cut, rel=6e-3)
    assert found.peak_sensitivity == pytest.approx(1 / nearest, rel=2e-3)
    assert found.pole_radius == pytest.approx(np.abs(control.feedback(system).poles()).max())
    assert found.stable == (found.pole_radius < 1)


@pytest.mark.parametrize("system", TEXTBOOK.values(), ids=TEXTBOOK.keys())
def test_the_disk_margin_is_one_over_the_peak_sensitivity(
    system: control.TransferFunction,
) -> None:
    w = np.geomspace(NYQUIST_RAD_PER_S * 1e-4, NYQUIST_RAD_PER_S * 0.9999, 2000)
    disk, _, _ = control.disk_margins(control.ss(system), w, skew=1.0)
    assert 1 / margins(looped(system)).peak_sensitivity == pytest.approx(disk, rel=2e-3)


@pytest.mark.parametrize("gain", [0.01, 0.1, 0.5])
def test_an_integrators_margins_are_known_in_closed_form(gain: float) -> None:
    found = margins(looped(tf([gain], [1, -1])))
    # |1 − e^(jωT)| = gain, and half a tick's delay on top of the integrator's 90°.
    wt = 2 * math.asin(gain / 2)
    assert found.pole_radius == pytest.approx(1 - gain)
    assert found.phase_deg == pytest.approx(90 - math.degrees(wt / 2), abs=1e-3)
    assert found.peak_sensitivity == pytest.approx(1 / (1 - gain / 2), rel=1e-4)


@pytest.mark.parametrize("gain", [0.01, 0.1, 0.5])
def test_an_integrators_delay_margin_is_known_in_closed_form(gain: float) -> None:
    wt = 2 * math.asin(gain / 2)
    expected_s = (math.pi / 2 - wt / 2) / wt * TICK_S
    assert margins(looped(tf([gain], [1, -1]))).delay_s == pytest.approx(expected_s, rel=1e-4)


@pytest.mark.parametrize("gain", [0.01, 0.1, 0.5])
def test_the_gain_margin_at_half_the_tick_rate_counts(gain: float) -> None:
    assert margins(looped(tf([gain], [1, -1]))).gain == pytest.approx(2 / gain, rel=1e-6)


@pytest.mark.parametrize(("gain", "stable"), [(1.99, True), (2.01, False)])
def test_a_loop_is_stable_while_its_poles_are_inside(gain: float, stable: bool) -> None:
    assert margins(looped(tf([gain], [1, -1]))).stable == stable


def response(case: Case, travel: float) -> NDArray[np.float64]:
    """The force that the shipped loop of an actuator with so much more travel settles to."""
    shipped = Shipped(case, travel)
    return np.array([shipped.tick() for _ in range(4000)])


@every_case
def test_the_shipped_loop_becomes_unstable_where_its_gain_margin_says(case: Case) -> None:
    margin = margins(case.linear()).gain
    assert np.ptp(response(case, 0.95 * margin)[3500:]) < 0.1e-3
    assert np.ptp(response(case, 1.05 * margin)[3500:]) > 0.1


@every_case
def test_it_becomes_unstable_where_its_delay_margin_says(case: Case) -> None:
    loop = case.linear()
    ticks = margins(loop).delay_s / TICK_S

    def pole_radius(delay: int) -> float:
        n = len(loop.a)
        late = np.zeros((n + delay, n + delay))
        late[:n, :n], late[:n, -1], late[n, :n] = loop.a, loop.b, loop.c
        late[n + 1 :, n:-1] = np.eye(delay - 1)
        poles = np.linalg.eigvals(late)
        # Without what an observer counts by itself, which is at 1.
        poles = poles[np.argsort(np.abs(poles - 1))][loop.counts :]
        return float(np.abs(poles).max())

    assert pole_radius(math.floor(ticks)) < 1 < pole_radius(math.ceil(ticks))


@pytest.mark.parametrize(("wander", "noise"), [(1.0, 0.0), (0.0, 1.0)])
@pytest.mark.parametrize("name", ["rotor and film", "observer"])
def test_felt_noise_is_what_a_long_run_of_noise_makes(
    name: str, wander: float, noise: float
) -> None:
    loop = CASES[name].linear()
    ticks, closed = 50_000, loop.closed
    rng = np.random.default_rng(7)
    readings_off = noise * rng.standard_normal(ticks)
    finger_moves = wander * math.sqrt(TICK_S) * rng.standard_normal(ticks)
    state, squares = np.zeros(len(closed)), 0.0
    for off, way in zip(readings_off.tolist(), finger_moves.tolist(), strict=True):
        state = closed @ state + off * loop.closed_noise + way * loop.displaced
        squares += float(loop.tip @ state) ** 2
    assert felt_noise(loop, wander, noise) == pytest.approx(math.sqrt(squares / ticks), rel=0.05)


def test_wander_and_noise_add_as_squares() -> None:
    loop = CASES["rotor and film"].linear()
    both, wander, noise, none = (
        felt_noise(loop, *given) for given in ((2.0, 0.1), (2.0, 0.0), (0.0, 0.1), (0.0, 0.0))
    )
    assert both == pytest.approx(math.hypot(wander, noise))
    assert none == 0.0


def display_scene(name: str) -> DisplayScene:
    return load_section(SCENES / f"{name}.toml", "display", DisplayScene)


def refuse(scene: DisplayScene) -> None:
    refuse_unstable(
        scene.controller, scene.actuator, LAYER, scene.film, LIMIT_N, scene.tick_ns * 1e-9
    )


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
def test_no_scene_of_ours_is_refused(path: Path) -> None:
    refuse(display_scene(path.stem))


def without_observer(kp: float) -> DisplayScene:
    scene = display_scene("real_bench")
    controller = scene.controller.model_copy(update={"observer": None, "kp": kp})
    return scene.model_copy(update={"controller": controller})


def test_an_unstable_loop_is_refused_in_one_line() -> None:
    with pytest.raises(SceneError, match=r"controller: the force loop is not stable") as caught:
        refuse(without_observer(kp=1000))
    assert "telepulse tune" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kp", [50.0, 100.0, 200.0, 400.0, 800.0, 1600.0])
def test_a_loop_is_refused_where_its_margins_are_unfit(kp: float) -> None:
    case = Case(POSITION | {"kp": kp}, ROTOR, SLOW)
    controller, actuator, film = case.scenes
    refused = False
    try:
        refuse_unstable(controller, actuator, LAYER, film, LIMIT_N, TICK_S)
    except SceneError:
        refused = True
    assert refused == (margins(case.linear()).unfit is not None) == (kp > 400)


def test_a_force_error_is_judged_up_to_the_limit() -> None:
    # On a hard finger the contact is stiffer the harder it presses: so is the loop.
    case = Case({"kp": 0.016}, ROTOR | {"fingertip": "1000 N/mm"}, SLOW)
    found = [margins(case.linear(share * LIMIT_N)) for share in FORCE_SHARES]
    assert [each.unfit is None for each in found] == [True, True, False]
    controller, actuator, film = case.scenes
    with pytest.raises(SceneError, match=r"at 2.5 N"):
        refuse_unstable(controller, actuator, LAYER, film, LIMIT_N, TICK_S)


def test_a_loop_next_to_instability_is_refused_too() -> None:
    margin = 0.01 * margins(looped(tf([0.01], [1, -1, 0, 0]))).gain
    fits = [margins(looped(tf([share * margin], [1, -1, 0, 0]))) for share in (0.7, 0.95, 1.05)]
    assert [each.stable for each in fits] == [True, True, False]
    assert [each.unfit is None for each in fits] == [True, False, False]
    assert "hardly stable" in (fits[1].unfit or "")
    assert "not stable" in (fits[2].unfit or "")
