import math

import pytest

from display_node.press.finger_press import BLIND_NS, SILENT_NS, FingerPress, PressLimits
from protocol.wire.messages import SetPoint

MS = 1_000_000
SESSION, PRESS = 7, 11


def pressed(press_n: float, seconds: float = 1.0) -> FingerPress:
    press = FingerPress(PressLimits(), PRESS)
    for number in range(round(seconds * 1e3)):
        press.read(press_n, 0.0, number * MS)
        press.tick(number * MS)
    return press


def request(press: FingerPress, now_ns: int, alive: bool = True) -> SetPoint | None:
    return press.request(SESSION, now_ns, 0, now_ns, alive)


def observe(
    press: FingerPress,
    hold_down_n: float,
    height_n: float,
    seconds: float = 4.0,
    batch: int = 5,
    from_s: float = 0.0,
) -> None:
    """Let frames of a pulse at a hold-down arrive."""
    for frame in range(round(seconds * 1e3) // batch):
        times_s = [from_s + 1e-3 * (batch * frame + number) for number in range(batch)]
        pulse = [height_n * (0.5 + 0.5 * math.sin(2 * math.pi * 1.25 * t_s)) for t_s in times_s]
        cell = [hold_down_n + force_n for force_n in pulse]
        press.observe([round(t_s * 1e9) for t_s in times_s], pulse, cell)


def test_nothing_is_sent_while_sensor_or_stream_are_silent() -> None:
    press = pressed(1.0)
    assert request(press, 1000 * MS) is not None
    assert request(press, 999 * MS + SILENT_NS + MS) is None
    press = pressed(1.0)
    assert request(press, 1000 * MS) is not None
    late_ns = 1000 * MS + BLIND_NS + MS
    press.read(1.0, 0.0, late_ns)
    assert request(press, late_ns, alive=False) is None
    assert FingerPress(PressLimits(), PRESS).request(SESSION, 0, 0, 0, True) is None


@pytest.mark.parametrize("reading_n", [math.nan, math.inf, -math.inf])
def test_a_reading_that_is_no_number_counts_as_none(reading_n: float) -> None:
    press = pressed(1.0)
    now_ns = 999 * MS + SILENT_NS + MS
    press.read(reading_n, 0.0, now_ns)
    assert request(press, now_ns) is None


def test_an_impossible_press_is_not_sent() -> None:
    limits = PressLimits()
    press = pressed(1.01 * limits.force_n * limits.overforce)
    assert press.press_n == limits.force_n
    assert request(press, 1000 * MS) is None


def test_the_pulse_felt_has_the_height_of_the_present_press() -> None:
    press = pressed(0.6)
    for hold_down_n, height_n in ((0.6, 0.06), (1.2, 0.3), (0.6, 0.06)):
        observe(press, hold_down_n, height_n)
    # Samples taken at the better hold-down are felt as the present press would give them.
    high, low = (press.felt_n(press.relative(force_n, 1.2, 0)) for force_n in (0.3, 0.0))
    felt_n = high - low
    assert felt_n == pytest.approx(0.06, rel=0.1)


def test_nothing_is_learnt_while_the_pulse_is_doubtful() -> None:
    press = pressed(1.2)
    press.take_beat(0.8, good=True)
    observe(press, 1.2, 0.3)
    press.take_beat(0.3, good=False)
    observe(press, 1.2, 3.0, from_s=4)
    assert press.curve.height(1.2) == pytest.approx(0.3, rel=0.02)
    press.take_beat(0.8, good=True)
    observe(press, 1.2, 0.6, seconds=40, from_s=8)
    assert press.curve.height(1.2) > 0.45


def test_a_doubtful_beat_without_another_is_doubted_for_some_seconds() -> None:
    """A law that was wrong at a force hid its beats for 14 s, and so was not mended."""
    press = pressed(1.2)
    press.take_beat(0.8, good=True)
    observe(press, 0.6, 0.3)
    press.take_beat(0.8, good=False)
    observe(press, 1.2, 0.1, seconds=1.5, from_s=4)
    assert press.curve.height(1.2) > 0.2
    observe(press, 1.2, 0.1, seconds=6, from_s=5.5)
    assert press.curve.height(1.2) == pytest.approx(0.1, rel=0.15)
