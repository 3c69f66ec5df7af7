import math
from dataclasses import dataclass, field
from pathlib import Path

import control
import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.control.force_loop import ForceLoop, build_force_loop
from display_node.control.linear_loop import (
    FORCE_SHARES,
    LinearLoop,
    felt_noise,
    linear_loop,
    margins,
    refuse_unstable,
)
from display_node.control.observer import DESIGN_FORCE_N
from display_node.control.scene import ControllerScene
from display_node.plant.film import FilmModel
from display_node.plant.scene import FilmTable, SecondOrderScene, StepperScene
from display_node.scene import DisplayScene
from protocol.errors import SceneError
from protocol.tactile import ElasticLayer
from tests.support.sender import SCENES, display_scene

TICK_S = 1e-3
LIMIT_N = 2.5
LAYER = ElasticLayer()
Table = dict[str, object]
# A lead so fine that microsteps have no effect.
FINE: Table = {"kind": "stepper", "lead": "1 nm", "microsteps": 256}


@dataclass(frozen=True)
class Case:
    """A controller, an actuator and a film, as tables of a scene."""

    controller: Table
    actuator: Table = field(default_factory=lambda: FINE)
    film: Table = field(default_factory=dict)

    @property
    def scenes(self) -> tuple[ControllerScene, SecondOrderScene | StepperScene, FilmTable]:
        kind = StepperScene if self.actuator["kind"] == "stepper" else SecondOrderScene
        return (
            ControllerScene.model_validate(self.controller),
            kind.model_validate(self.actuator),
            FilmTable.model_validate(self.film),
        )

    def linear(self, force_n: float = DESIGN_FORCE_N) -> LinearLoop:
        controller, actuator, film = self.scenes
        return linear_loop(controller, actuator, LAYER, film, TICK_S, force_n)

    @property
    def newtons_per_unit(self) -> float:
        """Force in N at the design force that one unit of the linear loop stands for."""
        _, actuator, _ = self.scenes
        if isinstance(actuator, SecondOrderScene):
            return 1.0
        return actuator.contact(LAYER).stiffness(DESIGN_FORCE_N)


class Shipped:
    """The loop that a case's scene builds, with the design force as its reference.

    Its film has the case's filter, but no noise or converter. travel: the actuator's travel over
    the travel that the controller assumes.
    """

    def __init__(self, case: Case, travel: float = 1.0) -> None:
        controller, actuator, film = case.scenes
        actual = None
        if isinstance(actuator, StepperScene):
            actual = actuator.model_copy(update={"lead_m": travel * actuator.lead_m})
        self.loop: ForceLoop = build_force_loop(
            controller, actuator, LAYER, film, LIMIT_N, TICK_S, actual
        )
        quiet = film.model_copy(update={"noise_n": 0.0, "adc_bits": None})
        self._film = FilmModel(quiet, TICK_S)

    def tick(self, reference_n: float = DESIGN_FORCE_N, noise_n: float = 0.0) -> float:
        """Return the felt force after a tick whose reading is wrong by `noise_n`."""
        reading_n = self._film.read(self.loop.felt_n) + noise_n
        self.loop.tick([reference_n] * (self.loop.horizon + 1), reading_n)
        return self.loop.felt_n

    def settled(self, ticks: int = 1000) -> "Shipped":
        for _ in range(ticks):
            self.tick()
        return self


NYQUIST_RAD_PER_S = math.pi / TICK_S
POSITION: Table = {"error": "position", "kp": 100}
OBSERVED = POSITION | {"feed_forward": True, "observer": {"wander": "0.1 mm", "softening": 0}}
PAPERS: Table = {"kp": 15, "ki": 0.15, "kd": 0.03, "derivative_filter": "200 Hz"}
ROTOR = FINE | {"rotor_resonance": "100 Hz"}
SECOND_ORDER: Table = {"kind": "second_order"}
SLOW: Table = {"filter": "40 Hz", "noise": "2 mN"}
LATE: Table = {"latency": "1.3 ms"}

UNFILTERED = {
    "position": Case(POSITION),
    "position, all gains": Case(POSITION | {"ki": 200, "kd": 0.05}),
    "force": Case({"kp": 0.1, "ki": 0.5, "kd": 1e-4}),
    "millivolts": Case({"kp": 2e-5, "error": "millivolts"}),
    "rotor": Case(POSITION | {"kp": 50}, ROTOR),
}
CASES = UNFILTERED | {
    "feed-forward": Case(POSITION | {"feed_forward": True}),
    "film": Case(POSITION | {"kp": 50}, FINE, SLOW | {"filter_order": 2}),
    "rotor and film": Case(POSITION | {"kp": 30}, ROTOR, SLOW),
    "observer": Case(OBSERVED, FINE, {"noise": "2 mN"}),
    "observer, rotor and film": Case(OBSERVED, ROTOR, SLOW),
    "observer, all": Case(OBSERVED | {"ki": 100, "kd": 0.02}, ROTOR, SLOW | {"filter_order": 3}),
    "late drive": Case(POSITION, FINE | {"latency": "2 ms"}),
    "late film": Case(POSITION, FINE, SLOW | LATE),
    "late rotor and film": Case(POSITION | {"kp": 30}, ROTOR | LATE, SLOW | {"latency": "3 ms"}),
    "observer, late drive": Case(OBSERVED, FINE | LATE, {"noise": "2 mN"}),
    "observer, all of it late": Case(OBSERVED, ROTOR | LATE, SLOW | {"latency": "4.5 ms"}),
    "second order": Case(PAPERS | {"error": "millivolts"}, SECOND_ORDER),
    "second order, newtons": Case(PAPERS, SECOND_ORDER),
    "second order and film": Case(
        PAPERS | {"error": "millivolts"}, SECOND_ORDER, {"filter": "300 Hz"}
    ),
    "second order and late film": Case(PAPERS, SECOND_ORDER, LATE),
}
every_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
JUDGED = ("film", "rotor", "rotor and film", "observer, rotor and film")
judged = pytest.mark.parametrize("case", [CASES[name] for name in JUDGED], ids=JUDGED)


def tips(loop: LinearLoop, noise: NDArray[np.float64]) -> NDArray[np.float64]:
    state, moved = np.zeros(len(loop.a)), []
    for value in noise.tolist():
        state = loop.closed @ state + loop.closed_noise * value
        moved.append(loop.tip @ state)
    return np.array(moved)


@every_case
def test_the_linear_loop_moves_as_the_shipped_one(case: Case) -> None:
    # An impulse, a step and noise in the loop's unit, small enough for a straight contact law.
    noise = np.zeros(400)
    noise[0], noise[100:200] = 1.0, 1.0
    noise[200:300] = np.random.default_rng(1).normal(0, 1, 100)
    noise *= 1e-6 if case.actuator is SECOND_ORDER else 1e-9
    disturbed, left_alone = Shipped(case).settled(), Shipped(case).settled()
    scale_n = case.newtons_per_unit
    off_n = [disturbed.tick(noise_n=scale_n * each) - left_alone.tick() for each in noise.tolist()]
    expected = tips(case.linear(), noise)
    for part in (slice(0, 100), slice(100, 200), slice(200, 400)):
        largest = np.abs(expected[part]).max()
        assert largest > 1e-11
        assert np.abs(np.array(off_n)[part] / scale_n - expected[part]).max() < 1e-3 * largest


@pytest.mark.parametrize("case", UNFILTERED.values(), ids=UNFILTERED.keys())
def test_a_displaced_finger_equals_a_jump_of_the_reference(case: Case) -> None:
    loop = case.linear()
    state, moved = loop.displaced, []
    jumped, left_alone = Shipped(case).settled(), Shipped(case).settled()
    jump_n = 1e-9 * case.newtons_per_unit
    off = []
    for _ in range(300):
        state = loop.closed @ state
        moved.append(loop.tip @ state)
        off.append((jumped.tick(DESIGN_FORCE_N + jump_n) - left_alone.tick()) / jump_n)
    assert np.abs(1 - np.array(off) - np.array(moved)).max() < 1e-3


@every_case
def test_after_a_displacement_the_loop_comes_to_rest(case: Case) -> None:
    loop = case.linear()
    assert np.abs(loop.poles()).max() < 1 - 1e-6
    assert loop.tip @ loop.displaced == 1.0
    state = np.linalg.matrix_power(loop.closed, 6000) @ loop.displaced
    # With the paper's gains in newtons, the actuator swings for seconds.
    assert abs(loop.tip @ state) < 0.05


def looped(z_domain: control.TransferFunction) -> LinearLoop:
    """Return a transfer function of z with negative feedback of 1."""
    system = control.ss(z_domain)
    a, b, c = system.A, system.B[:, 0], system.C[0]
    zeros = np.zeros(len(a))
    return LinearLoop(TICK_S, a, b, -c, zeros, -1.0, c, displaced=zeros)


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
    # The step from one frequency to the next limits the accuracy.
    assert found.delay_s == pytest.approx(math.radians(phase_deg) / gain_cut, rel=6e-3)
    assert found.peak_sensitivity == pytest.approx(1 / nearest, rel=2e-3)
    assert found.pole_radius == pytest.approx(np.abs(control.feedback(system).poles()).max())
    assert found.stable == (found.pole_radius < 1)
    disk, _, _ = control.disk_margins(control.ss(system), w[w > w[-1] * 1e-4], skew=1.0)
    assert 1 / found.peak_sensitivity == pytest.approx(disk, rel=2e-3)


def response(case: Case, travel: float) -> NDArray[np.float64]:
    """Return the force of the shipped loop, in 4 s, whose actuator moves `travel` times as far."""
    shipped = Shipped(case, travel)
    return np.array([shipped.tick() for _ in range(4000)])


@judged
def test_the_shipped_loop_becomes_unstable_at_its_gain_margin(case: Case) -> None:
    margin = margins(case.linear()).gain
    assert np.ptp(response(case, 0.95 * margin)[3500:]) < 0.1e-3
    assert np.ptp(response(case, 1.05 * margin)[3500:]) > 0.1


@pytest.mark.parametrize(("wander", "noise"), [(2.0, 0.0), (0.0, 0.1), (2.0, 0.1)])
@pytest.mark.parametrize("name", ["rotor and film", "observer, rotor and film"])
def test_felt_noise_is_that_of_a_long_noisy_run(name: str, wander: float, noise: float) -> None:
    loop = CASES[name].linear()
    ticks, closed = 50_000, loop.closed
    rng = np.random.default_rng(7)
    readings_off = noise * rng.standard_normal(ticks)
    finger_moves = wander * math.sqrt(TICK_S) * rng.standard_normal(ticks)
    state, squares = np.zeros(len(closed)), 0.0
    for error, moved in zip(readings_off.tolist(), finger_moves.tolist(), strict=True):
        state = closed @ state + error * loop.closed_noise + moved * loop.displaced
        squares += float(loop.tip @ state) ** 2
    assert felt_noise(loop, wander, noise) == pytest.approx(math.sqrt(squares / ticks), rel=0.05)


def refuse(scene: DisplayScene) -> None:
    refuse_unstable(
        scene.controller, scene.actuator, LAYER, scene.film, LIMIT_N, scene.tick_ns * 1e-9
    )


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
def test_no_shipped_scene_is_refused(path: Path) -> None:
    refuse(display_scene(path.stem))


def test_an_unstable_loop_is_refused_in_one_line() -> None:
    scene = display_scene("real_bench")
    controller = scene.controller.model_copy(update={"observer": None, "kp": 1000.0})
    with pytest.raises(SceneError, match=r"controller: the force loop is not stable") as caught:
        refuse(scene.model_copy(update={"controller": controller}))
    assert "telepulse tune" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_force_error_is_checked_up_to_the_limit() -> None:
    # On a hard finger, contact and loop become stiffer with the force.
    case = Case({"kp": 0.016}, ROTOR | {"fingertip": "1000 N/mm"}, SLOW)
    found = [margins(case.linear(share * LIMIT_N)) for share in FORCE_SHARES]
    assert [each.unfit is None for each in found] == [True, True, False]
    controller, actuator, film = case.scenes
    with pytest.raises(SceneError, match=r"at 2.5 N"):
        refuse_unstable(controller, actuator, LAYER, film, LIMIT_N, TICK_S)


def test_a_loop_near_instability_is_refused() -> None:
    margin = 0.01 * margins(looped(tf([0.01], [1, -1, 0, 0]))).gain
    fits = [margins(looped(tf([share * margin], [1, -1, 0, 0]))) for share in (0.7, 0.95, 1.05)]
    assert [each.stable for each in fits] == [True, True, False]
    assert [each.unfit is None for each in fits] == [True, False, False]
    assert "hardly stable" in (fits[1].unfit or "")
    assert "not stable" in (fits[2].unfit or "")
