import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.tactile import (
    Adc,
    Calibration,
    ElasticLayer,
    Film,
    half_space_stress,
    matching_force_ratio,
)

TABLE_3 = ElasticLayer(young_modulus_pa=0.05e9, thickness_m=2e-3, poisson_ratio=0.5)
ADC = Adc(bits=4, range_volts=8.0)
BAD = [0.0, -1.0, math.nan, math.inf]
LAYERS = [
    TABLE_3,
    ElasticLayer(),
    ElasticLayer(1e5, 5e-3, 0.3, 0.02),
    ElasticLayer(2e6, 1e-3, 0.0, 0.01),
]


def test_the_default_layer_is_that_of_table_3() -> None:
    assert ElasticLayer() == TABLE_3
    assert TABLE_3.strain(1.0) == pytest.approx(-4.7746e-6, abs=5e-11)


def test_a_films_voltage_follows_its_equations() -> None:
    assert Film(radius_m=9e-3).volts_per_newton == pytest.approx(5.305, rel=1e-4)
    film, thickness_m, force_n = Film(8e-3, g31=0.2, g32=0.1), 2.5e-6, 0.7
    stress_pa = force_n / (2 * math.pi * film.radius_m * thickness_m)
    expected_v = (0.2 + 0.1) * stress_pa * thickness_m
    assert force_n * film.volts_per_newton == pytest.approx(expected_v)


@given(st.floats(-100, 100), st.sampled_from(LAYERS))
def test_force_and_strain_are_each_others_inverse(force_n: float, layer: ElasticLayer) -> None:
    assert layer.force(layer.strain(force_n)) == pytest.approx(force_n)


@pytest.mark.parametrize("layer", LAYERS)
def test_the_strain_of_the_stress_on_the_axis_is_the_layers(layer: ElasticLayer) -> None:
    force_n = 0.7
    load_n_per_m = force_n / layer.contact_length_m
    depth_m, young_pa, nu = layer.thickness_m, layer.young_modulus_pa, layer.poisson_ratio
    stresses = half_space_stress(load_n_per_m, np.zeros(1), np.array([depth_m]))
    # Plane strain (eqs 13-14).
    strain_z = ((1 - nu**2) * stresses[1] - nu * (1 + nu) * stresses[0]) / young_pa
    scale = 2 * load_n_per_m / (young_pa * math.pi * depth_m)
    assert strain_z[0] == pytest.approx(scale * (nu**2 - 1))
    assert strain_z[0] == pytest.approx(layer.strain(force_n))


@pytest.mark.parametrize("sensing", LAYERS)
@pytest.mark.parametrize("display", LAYERS)
def test_forces_in_the_matching_ratio_make_equal_strains(
    sensing: ElasticLayer, display: ElasticLayer
) -> None:
    pulse_n = 0.3
    felt_n = pulse_n * matching_force_ratio(sensing, display)
    assert display.strain(felt_n) == pytest.approx(sensing.strain(pulse_n))
    assert matching_force_ratio(TABLE_3, ElasticLayer(0.1e9)) == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("young_modulus_pa", BAD),
        ("thickness_m", BAD),
        ("contact_length_m", BAD),
        ("poisson_ratio", [-0.01, 0.51, math.nan, math.inf]),
    ],
)
def test_a_layer_refuses_values_out_of_range(name: str, values: list[float]) -> None:
    for value in values:
        with pytest.raises(ValueError, match=name):
            ElasticLayer(**{name: value})


@pytest.mark.parametrize("size", [1e-300, 1e300])
def test_a_layer_refuses_a_strain_beyond_all_numbers(size: float) -> None:
    with pytest.raises(ValueError, match="strain per newton"):
        ElasticLayer(young_modulus_pa=size, thickness_m=size)


@pytest.mark.parametrize("value", BAD)
def test_a_film_refuses_values_out_of_range(value: float) -> None:
    with pytest.raises(ValueError, match="radius_m"):
        Film(value)
    with pytest.raises(ValueError, match="g31"):
        Film(9e-3, g31=value or -0.15)


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
        (0.0, 0.0, 0), (0.49, 0.0, 0), (0.51, 1.0, 0), (-0.51, -1.0, 0), (6.9, 7.0, 0),
        (7.4, 7.0, 0), (7.6, 7.0, 1), (8.0, 7.0, 1), (-8.0, -8.0, 0), (-8.4, -8.0, 0),
        (-8.6, -8.0, 1), (1e300, 7.0, 1), (-math.inf, -8.0, 1),
    ],
)  # fmt: skip
def test_four_bits_over_8_volts(volts: float, read: float, clips: int) -> None:
    assert (ADC.step_volts, ADC.quantise(volts)) == (1.0, read)
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


@pytest.mark.parametrize("volts", [math.nan, np.array([0.0, math.nan])], ids=["one", "array"])
def test_nan_is_never_read_as_a_voltage(volts: float) -> None:
    with pytest.raises(ValueError, match="a voltage is NaN"):
        ADC.quantise(volts)


@pytest.mark.parametrize(
    ("bits", "full"), [(1, 1.0), (33, 1.0), (8, 0.0), (8, -1.0), (8, math.inf), (8, math.nan)]
)
def test_an_impossible_adc_is_refused(bits: int, full: float) -> None:
    with pytest.raises(ValueError, match="it must be"):
        Adc(bits, full)
