import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.tactile import Adc, Calibration, Film

ADC = Adc(bits=4, range_volts=8.0)


def test_without_a_word_the_line_is_that_of_fig_4() -> None:
    assert Calibration().volts(2.5) == pytest.approx(0.110)
    assert Calibration().volts(0.0) == 0.0


def test_a_films_line_is_eq_21() -> None:
    film = Film(9e-3)
    assert Calibration.of_film(film).volts(0.3) == pytest.approx(film.volts(0.3))
    assert Calibration.of_film(film).newtons(2.0) == pytest.approx(film.newtons(2.0))


@given(st.floats(-100, 100), st.floats(0.01, 100), st.floats(-10, 10))
def test_newtons_undo_volts(force_n: float, slope: float, offset: float) -> None:
    line = Calibration(slope, offset)
    assert line.volts(0.0) == pytest.approx(offset)
    assert line.volts(1.0) - line.volts(0.0) == pytest.approx(slope, rel=1e-6, abs=1e-12)
    assert line.newtons(line.volts(force_n)) == pytest.approx(force_n, abs=1e-9)
    array = np.array([[force_n, 0.0]])
    np.testing.assert_array_equal(line.volts(array), [[line.volts(force_n), offset]])
    np.testing.assert_array_equal(line.newtons(array)[0, 0], line.newtons(force_n))


@pytest.mark.parametrize(
    ("slope", "offset"), [(0.0, 0.0), (math.nan, 0.0), (math.inf, 0.0), (1.0, math.nan)]
)
def test_a_line_without_an_inverse_is_refused(slope: float, offset: float) -> None:
    with pytest.raises(ValueError, match="it must be finite"):
        Calibration(slope, offset)


@pytest.mark.parametrize(
    ("volts", "read", "clips"),
    [
        (0.0, 0.0, 0),
        (0.49, 0.0, 0),
        (0.51, 1.0, 0),
        (-0.51, -1.0, 0),
        (6.9, 7.0, 0),
        (7.4, 7.0, 0),
        (7.6, 7.0, 1),
        (8.0, 7.0, 1),
        (-8.0, -8.0, 0),
        (-8.4, -8.0, 0),
        (-8.6, -8.0, 1),
        (1e300, 7.0, 1),
        (-math.inf, -8.0, 1),
    ],
)
def test_four_bits_over_8_volts(volts: float, read: float, clips: int) -> None:
    assert ADC.step_volts == 1.0
    assert ADC.quantise(volts) == read
    assert type(ADC.quantise(volts)) is float
    np.testing.assert_array_equal(ADC.quantise(np.array([[volts, 2.2]])), [[read, 2.0]])
    clipped = ADC.clips(np.array([[volts], [0.0], [volts]]))
    assert clipped.tolist() == [[bool(clips)], [False], [bool(clips)]]


@given(st.integers(2, 32), st.floats(1e-3, 1e3), st.floats(-1, 1))
def test_a_reading_is_a_code_and_within_half_a_step(bits: int, full: float, share: float) -> None:
    adc = Adc(bits, full)
    assert adc.step_volts * 2**bits == 2 * full
    volts = share * (full - adc.step_volts)
    read = adc.quantise(volts)
    assert read == round(read / adc.step_volts) * adc.step_volts
    assert abs(read - volts) <= 0.5 * adc.step_volts * (1 + 1e-6)
    assert adc.quantise(np.array([volts]))[0] == read
    assert not adc.clips(np.array([volts])).any()


def test_a_ramp_meets_every_code_once() -> None:
    adc = Adc(10, 5.0)
    ramp = np.linspace(-5.0, 5.0 - adc.step_volts, 1024)
    codes = adc.quantise(ramp) / adc.step_volts
    np.testing.assert_array_equal(codes, np.arange(-512, 512))


def test_nan_is_never_read_as_a_voltage() -> None:
    with pytest.raises(ValueError, match="a voltage is NaN"):
        ADC.quantise(math.nan)
    with pytest.raises(ValueError, match="a voltage is NaN"):
        ADC.quantise(np.array([0.0, math.nan]))


@pytest.mark.parametrize(
    ("bits", "full"), [(1, 1.0), (33, 1.0), (8, 0.0), (8, -1.0), (8, math.inf), (8, math.nan)]
)
def test_an_adc_that_cannot_be_is_refused(bits: int, full: float) -> None:
    with pytest.raises(ValueError, match="it must be"):
        Adc(bits, full)
