import numpy as np
import pytest

from display_node.press.finger import FOLLOWS_S, PressingFinger


def test_the_sensor_reads_the_press_and_its_share_of_the_pulse() -> None:
    finger = PressingFinger(pulse_share=0.5, noise_n=0.0)
    assert finger.step(1.0, 0.0, 0.2, 1e-3) == pytest.approx(1.1)
    assert finger.press_n == 1.0


def test_a_tip_that_yields_lowers_the_force_until_the_hand_has_followed() -> None:
    finger = PressingFinger(300.0, noise_n=0.0)
    finger.step(1.0, 1e-3, 0.0, 1e-3)
    assert finger.press_n == pytest.approx(0.7, abs=0.01)
    for _ in range(round(5 * FOLLOWS_S / 1e-3)):
        finger.step(1.0, 1e-3, 0.0, 1e-3)
    assert finger.press_n == pytest.approx(1.0, abs=0.01)


def test_a_finger_does_not_pull() -> None:
    finger = PressingFinger(3000.0, noise_n=1e-3)
    readings = [finger.step(0.1, 5e-3, 0.3, 1e-4) for _ in range(50)]
    assert finger.press_n == 0.0
    assert np.abs(readings).max() < 0.01
