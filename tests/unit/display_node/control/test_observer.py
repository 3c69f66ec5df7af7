import math

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.control.observer import (
    DESIGN_FORCE_N,
    MAX_OFFSET_M,
    OUTLIER,
    SOFTNESS_RANGE,
    Observer,
    observer_gains,
)
from display_node.control.scene import ObserverScene
from display_node.plant.contact import ContactLaw
from display_node.plant.film import FilmModel
from display_node.plant.scene import FilmTable, StepperScene
from display_node.plant.stepper import Stepper
from protocol.tactile import ElasticLayer

TICK_S = 1e-3
SCENE = StepperScene.model_validate({"kind": "stepper", "rotor_resonance": "100 Hz"})
# A finger of the scene's compliance, and one whose compliance is learnt.
KNOWN = ObserverScene.model_validate({"wander": "0.1 mm", "softening": 0})
LEARNING = ObserverScene.model_validate({"wander": "0.1 mm"})
SLOW = FilmTable.model_validate({"filter": "40 Hz"})
# The noise for which the gains are designed; the bench's film itself has none.
NOISY = FilmTable.model_validate({"filter": "40 Hz", "noise": "2 mN"})


def contact(fingertip_n_per_m: float = 1e3) -> ContactLaw:
    finger = SCENE.model_copy(update={"fingertip_n_per_m": fingertip_n_per_m})
    return finger.contact(ElasticLayer())


def stepper() -> Stepper:
    return Stepper(SCENE, contact(), 2.5, TICK_S)


class Bench:
    """A stepper, a film without noise and an observer of both.

    The finger is `displaced_m` nearer than in the observer's model.
    """

    def __init__(
        self, film: FilmTable = NOISY, scene: ObserverScene = KNOWN, fingertip_n_per_m: float = 1e3
    ) -> None:
        quiet = film.model_copy(update={"noise_n": 0.0})
        self.learnt = contact()
        self.observer = Observer(scene, stepper(), self.learnt, film, SCENE.step_m, TICK_S)
        self.law = contact(fingertip_n_per_m)
        self.displaced_m = 0.0
        self._film = FilmModel(quiet, TICK_S)
        self._stepper = stepper()
        self.felt_n = self.reading_n = 0.0

    def tick(self, speed_m_per_s: float, reading_n: float | None = None) -> None:
        self.reading_n = self._film.read(self.felt_n)
        self.observer.correct(self.reading_n if reading_n is None else reading_n)
        self.observer.move(speed_m_per_s)
        self.felt_n = self.law.force(self._stepper.move(speed_m_per_s) + self.displaced_m)

    def swing(self, ticks: int) -> None:
        """Press and release a little, five times a second."""
        for tick in range(ticks):
            self.tick(0.003 * math.cos(2 * math.pi * 5 * tick * TICK_S))

    @property
    def error_m(self) -> float:
        """Error of the estimated position of the finger."""
        return self.law.position(self.felt_n) - self.law.position(self.observer.force_n)


def pressing(bench: Bench) -> Bench:
    """Return the bench at rest at the design force, without an error."""
    travel_m = bench.law.position(DESIGN_FORCE_N)
    for tick in range(300):
        bench.tick(travel_m / 0.1 if tick < 100 else 0.0)
    return bench


@pytest.mark.parametrize("displaced_m", [50e-6, -50e-6])
def test_a_displaced_finger_is_found_in_motion(displaced_m: float) -> None:
    bench = pressing(Bench())
    bench.displaced_m = displaced_m
    bench.swing(1000)
    assert bench.error_m == pytest.approx(0, abs=20e-9)
    for _ in range(300):
        bench.tick(0.0)
    expected_m = bench.law.position(bench.felt_n)
    assert bench.observer.screw_m == pytest.approx(expected_m, abs=SCENE.step_m)


def gain(film: FilmTable, wander_n: float = 0.05) -> float:
    """Return the gain of the offset."""
    return observer_gains(film, wander_n, 1e-4, TICK_S)[0]


def error_dynamics(film: FilmTable) -> NDArray[np.float64]:
    """Return the matrix of a tick for errors in (offset, filter states), by the gains."""
    low_pass = film.low_pass(TICK_S)
    assert low_pass is not None
    stiffness = contact().stiffness(DESIGN_FORCE_N)
    offset_gain, filter_gains = observer_gains(
        film, KNOWN.wander_m * stiffness, SCENE.step_m * stiffness / math.sqrt(12), TICK_S
    )
    a = np.block([[np.ones((1, 1)), np.zeros((1, len(low_pass.a)))], [low_pass.b, low_pass.a]])
    gains = np.array([offset_gain, *filter_gains])
    closed: NDArray[np.float64] = a - np.outer(gains, np.hstack([low_pass.d, low_pass.c]))
    return closed


@pytest.mark.parametrize("order", [1, 3])
@pytest.mark.parametrize("noise_n", [0.2e-3, 2e-3, 20e-3])
def test_an_error_decays_as_the_stationary_gains_predict(noise_n: float, order: int) -> None:
    film = NOISY.model_copy(update={"noise_n": noise_n, "filter_order": order})
    bench, closed = pressing(Bench(film)), error_dynamics(film)
    # Small enough for a straight contact law.
    bench.displaced_m = 1e-9
    error = np.array([1e-9] + [0.0] * order)
    for _ in range(100):
        bench.tick(0.0)
        assert bench.error_m == pytest.approx(error[0], abs=2e-12)
        error = closed @ error
    assert abs(error[0]) < 20e-12


@pytest.mark.parametrize("reading_n", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("order", [1, 4])
def test_the_felt_force_is_estimated_and_a_reading_that_is_no_number_ignored(
    reading_n: float, order: int
) -> None:
    film = NOISY.model_copy(update={"filter_order": order})
    bench, undisturbed = pressing(Bench(film)), pressing(Bench(film))
    for tick in range(300):
        speed = 0.005 * math.cos(2 * math.pi * 5 * tick * TICK_S)
        bench.tick(speed, reading_n if 50 <= tick < 80 else None)
        undisturbed.tick(speed)
        # Meanwhile the model of the film has advanced.
        assert bench.observer.force_n == pytest.approx(undisturbed.observer.force_n, rel=1e-9)
        assert bench.observer.force_n == pytest.approx(bench.felt_n, rel=1e-9)


def test_a_coarse_adc_counts_as_noise() -> None:
    table = {"filter": "40 Hz", "sensitivity": "44 mV/N"}
    coarse, fine = (FilmTable.model_validate(table | {"adc_bits": bits}) for bits in (12, 16))
    assert gain(coarse) < 0.5 * gain(fine)


@pytest.mark.parametrize("wander_n", [0.005, 0.05, 0.5])
def test_without_a_filter_the_gain_is_that_of_a_scalar_kalman_filter(wander_n: float) -> None:
    noise_n, least_n = 2e-3, 1e-4
    film = FilmTable.model_validate({"noise": "2 mN"})
    offset_gain, filter_gains = observer_gains(film, wander_n, least_n, TICK_S)
    # p = p r / (p + r) + q.
    q, r = wander_n**2 * TICK_S, noise_n**2 + least_n**2
    p = (q + math.sqrt(q * q + 4 * q * r)) / 2
    assert filter_gains == []
    assert offset_gain == pytest.approx(p / (p + r), rel=1e-6)


@pytest.mark.parametrize(("reading_n", "bound_m"), [(1e3, MAX_OFFSET_M), (-1e3, -MAX_OFFSET_M)])
def test_no_reading_moves_the_finger_beyond_its_bounds(reading_n: float, bound_m: float) -> None:
    bench = Bench(SLOW, LEARNING)
    softness = bench.learnt.finger_m_per_n
    least, most = SOFTNESS_RANGE
    for _ in range(3000):
        bench.observer.correct(reading_n)
        assert abs(bench.observer.screw_m) <= MAX_OFFSET_M
        assert least * softness <= bench.learnt.finger_m_per_n <= most * softness
    assert bench.observer.screw_m == bound_m


@pytest.mark.parametrize("glitch_n", [1.0, 100.0, -100.0])
def test_one_wild_reading_counts_no_more_than_an_outlier(glitch_n: float) -> None:
    bench, mildly = pressing(Bench()), pressing(Bench())
    before_m = bench.observer.screw_m
    bench.tick(0.0, DESIGN_FORCE_N + glitch_n)
    mildly.tick(0.0, DESIGN_FORCE_N + math.copysign(10.0, glitch_n))
    moved_m = bench.observer.screw_m - before_m
    assert math.copysign(1.0, moved_m) == math.copysign(1.0, glitch_n)
    assert moved_m == mildly.observer.screw_m - before_m
    # A settled Kalman filter moves a random walk by the walk's own step per standard deviation.
    step_m = KNOWN.wander_m * math.sqrt(TICK_S)
    assert abs(moved_m) == pytest.approx(OUTLIER * step_m, rel=1e-3)


def test_a_light_touch_does_not_disturb_the_estimate() -> None:
    # Without touch the stiffness, which is a divisor, is 0.
    bench = Bench(SLOW)
    bench.observer.correct(1e-4)
    assert 0 < bench.observer.screw_m < 10e-6


@pytest.mark.parametrize("fingertip_n_per_m", [500.0, 1200.0])
def test_the_finger_stiffness_is_learnt(fingertip_n_per_m: float) -> None:
    learnt, deviations_n = [], []
    for scene in (LEARNING, KNOWN):
        bench = pressing(Bench(NOISY, scene, fingertip_n_per_m))
        bench.swing(5000)
        learnt.append(bench.learnt.finger_m_per_n)
        errors_n = []
        for tick in range(200):
            bench.tick(0.003 * math.cos(2 * math.pi * 5 * tick * TICK_S))
            errors_n.append(bench.felt_n - bench.observer.force_n)
        deviations_n.append(np.std(errors_n))
    assert learnt == [pytest.approx(1 / fingertip_n_per_m, rel=0.02), 1e-3]
    assert deviations_n[0] < 0.2 * deviations_n[1]


def test_at_rest_the_force_is_found_with_any_stiffness() -> None:
    # At rest, place and stiffness of the finger cannot be told apart.
    bench = pressing(Bench(NOISY, LEARNING, 500.0))
    for _ in range(2000):
        bench.tick(0.0)
    assert bench.observer.force_n == pytest.approx(bench.felt_n, abs=0.1e-3)


@pytest.mark.parametrize("table", [{"wander": "0 mm"}, {"wander": "1 mm", "softening": 2}])
def test_impossible_motions_of_a_finger_are_refused(table: dict[str, object]) -> None:
    with pytest.raises(ValueError, match="validation error"):
        ObserverScene.model_validate(table)
