import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import trapezoid

from protocol.tactile import (
    ElasticLayer,
    Film,
    half_space_stress,
    matching_force_ratio,
    plane_strain,
)

TABLE_3 = ElasticLayer(young_modulus_pa=0.05e9, thickness_m=2e-3, poisson_ratio=0.5)
LAYERS = [
    TABLE_3,
    ElasticLayer(),
    ElasticLayer(1e5, 5e-3, 0.3, 0.02),
    ElasticLayer(2e6, 1e-3, 0.0, 0.01),
]


def test_the_layer_of_table_3_is_the_default() -> None:
    assert ElasticLayer() == TABLE_3


def test_the_papers_strain_per_newton() -> None:
    assert TABLE_3.strain(1.0) == pytest.approx(-4.7746e-6, abs=5e-11)


@pytest.mark.parametrize(
    ("strain", "newtons"),
    [(9.4249e-9, 1.974e-3), (5.7802e-8, 12.106e-3), (9.961e-8, 20.863e-3)],
)
def test_the_papers_strain_errors_as_forces(strain: float, newtons: float) -> None:
    assert TABLE_3.force(-strain) == pytest.approx(newtons, rel=2e-4)


def test_the_papers_film_under_the_finger() -> None:
    assert Film(radius_m=9e-3).volts(1.0) == pytest.approx(5.305, rel=1e-4)


def test_equal_film_voltages_at_both_ends_are_forces_as_their_radii() -> None:
    wrist, finger = Film(8e-3), Film(9e-3)
    assert finger.newtons(wrist.volts(0.8)) == pytest.approx(0.9)


def test_a_films_voltage_and_force_follow_its_equations() -> None:
    film, thickness_m, force_n = Film(8e-3, g31=0.2, g32=0.1), 2.5e-6, 0.7
    stress_pa = force_n / (2 * math.pi * film.radius_m * thickness_m)
    assert film.volts(force_n) == pytest.approx((0.2 + 0.1) * stress_pa * thickness_m)
    assert film.newtons(film.volts(force_n)) == pytest.approx(force_n)


@given(st.floats(-100, 100), st.sampled_from(LAYERS))
def test_force_and_strain_are_each_others_inverse(force_n: float, layer: ElasticLayer) -> None:
    assert layer.force(layer.strain(force_n)) == pytest.approx(force_n)


def test_an_array_keeps_its_shape() -> None:
    forces_n = np.linspace(0, 1, 6).reshape(2, 3)
    assert TABLE_3.strain(forces_n).shape == (2, 3)
    assert Film(9e-3).volts(forces_n).shape == (2, 3)
    np.testing.assert_allclose(TABLE_3.force(TABLE_3.strain(forces_n)), forces_n)


@pytest.mark.parametrize("depth_m", [1e-4, 2e-3, 0.5])
def test_the_stress_on_the_axis(depth_m: float) -> None:
    sigma_x, sigma_z = half_space_stress(3.0, np.array([0.0]), np.array([depth_m]))
    assert sigma_x[0] == 0
    assert sigma_z[0] == pytest.approx(-2 * 3.0 / (math.pi * depth_m))


def test_the_stress_beside_the_axis() -> None:
    x, z = 1.5e-3, 2e-3
    sigma_x, sigma_z = half_space_stress(3.0, np.array([x, -x]), np.array([z]))
    radius_4 = (x**2 + z**2) ** 2
    assert sigma_x == pytest.approx(2 * [-2 * 3.0 * x**2 * z / (math.pi * radius_4)])
    assert sigma_z == pytest.approx(2 * [-2 * 3.0 * z**3 / (math.pi * radius_4)])


@pytest.mark.parametrize("depth_m", [5e-4, 2e-3])
def test_at_every_depth_the_stress_carries_the_whole_load(depth_m: float) -> None:
    x_m = depth_m * np.tan(np.linspace(-1.5707, 1.5707, 20_001))
    sigma_x, sigma_z = half_space_stress(3.0, x_m, np.array([depth_m]))
    assert trapezoid(sigma_z, x_m) == pytest.approx(-3.0, rel=1e-6)
    # On an upright plane beside the load, the horizontal push is P / π at any distance.
    depths_m = x_m[x_m > 0]
    across_x, _ = half_space_stress(3.0, np.array([depth_m]), depths_m)
    assert trapezoid(across_x, depths_m) == pytest.approx(-3.0 / math.pi, rel=1e-3)
    assert (sigma_x <= 0).all()


def test_places_and_depths_broadcast() -> None:
    sigma_x, sigma_z = half_space_stress(1.0, np.zeros((1, 5)), np.ones((4, 1)))
    assert sigma_x.shape == sigma_z.shape == (4, 5)


def test_far_and_near_do_not_overflow() -> None:
    places = np.array([1e-150, 1.0, 1e70])
    for stress in half_space_stress(1.0, places, np.array([[1e-3], [1e3]])):
        assert np.isfinite(stress).all()


@pytest.mark.parametrize("depth_m", [0.0, -1e-3, math.nan])
def test_there_is_no_stress_at_the_load_itself(depth_m: float) -> None:
    with pytest.raises(ValueError, match="z_m"):
        half_space_stress(1.0, np.zeros(2), np.array([1e-3, depth_m]))


@pytest.mark.parametrize("layer", LAYERS)
def test_the_strain_of_the_stress_on_the_axis_is_the_layers(layer: ElasticLayer) -> None:
    force_n = 0.7
    load_n_per_m = force_n / layer.contact_length_m
    depth_m, young_pa, nu = layer.thickness_m, layer.young_modulus_pa, layer.poisson_ratio
    stresses = half_space_stress(load_n_per_m, np.zeros(1), np.array([depth_m]))
    strain_x, strain_z = plane_strain(*stresses, young_pa, nu)
    scale = 2 * load_n_per_m / (young_pa * math.pi * depth_m)
    assert strain_x[0] == pytest.approx(scale * nu * (1 + nu))
    assert strain_z[0] == pytest.approx(scale * (nu**2 - 1))
    assert strain_z[0] == pytest.approx(layer.strain(force_n))


def test_plane_strain_with_both_stresses() -> None:
    strain_x, strain_z = plane_strain(3e5, -2e5, 1e7, 0.4)
    assert strain_x == pytest.approx(((1 - 0.4**2) * 3e5 - 0.4 * 1.4 * -2e5) / 1e7)
    assert strain_z == pytest.approx(((1 - 0.4**2) * -2e5 - 0.4 * 1.4 * 3e5) / 1e7)


@pytest.mark.parametrize("sensing", LAYERS)
@pytest.mark.parametrize("display", LAYERS)
def test_forces_in_the_matching_ratio_strain_both_layers_alike(
    sensing: ElasticLayer, display: ElasticLayer
) -> None:
    pulse_n = 0.3
    felt_n = pulse_n * matching_force_ratio(sensing, display)
    assert display.strain(felt_n) == pytest.approx(sensing.strain(pulse_n))


def test_a_rubber_twice_as_stiff_takes_twice_the_force() -> None:
    assert matching_force_ratio(TABLE_3, ElasticLayer(0.1e9)) == pytest.approx(2.0)


BAD = [0.0, -1.0, math.nan, math.inf]


@pytest.mark.parametrize("value", BAD)
@pytest.mark.parametrize("name", ["young_modulus_pa", "thickness_m", "contact_length_m"])
def test_a_layer_refuses_what_cannot_be(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        ElasticLayer(**{name: value})


@pytest.mark.parametrize("ratio", [-0.01, 0.51, math.nan, math.inf])
def test_a_layer_refuses_an_impossible_poisson_ratio(ratio: float) -> None:
    with pytest.raises(ValueError, match="poisson_ratio"):
        ElasticLayer(poisson_ratio=ratio)


@pytest.mark.parametrize("size", [1e-300, 1e300])
def test_a_layer_refuses_a_strain_beyond_all_numbers(size: float) -> None:
    with pytest.raises(ValueError, match="strain per newton"):
        ElasticLayer(young_modulus_pa=size, thickness_m=size)


@pytest.mark.parametrize("radius_m", BAD)
def test_a_film_refuses_an_impossible_radius(radius_m: float) -> None:
    with pytest.raises(ValueError, match="radius_m"):
        Film(radius_m)


@pytest.mark.parametrize("g31", [-0.15, -1.0, math.nan, math.inf])
def test_a_film_refuses_coefficients_without_a_voltage(g31: float) -> None:
    with pytest.raises(ValueError, match="g31"):
        Film(9e-3, g31=g31)
