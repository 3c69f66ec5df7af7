import math

import numpy as np
import pytest

from display_node.plant.film import FilmModel
from display_node.plant.scene import FilmTable

TICK_S = 1e-3


def table(**keys: object) -> FilmTable:
    return FilmTable.model_validate(keys)


def film(**keys: object) -> FilmModel:
    return FilmModel(table(**keys), TICK_S)


def readings(under_test: FilmModel, force_n: float, ticks: int) -> list[float]:
    return [under_test.read(force_n) for _ in range(ticks)]


@pytest.mark.parametrize("force_n", [0.0, 0.3, -1.0, 1e9, 5e-324])
def test_an_ideal_film_reads_the_felt_force(force_n: float) -> None:
    assert readings(film(), force_n, 3) == [force_n] * 3


def test_the_noise_has_its_rms_and_no_mean_or_memory() -> None:
    errors_n = np.array(readings(film(noise="2 mN"), 0.3, 20_000)) - 0.3
    assert math.sqrt(np.mean(errors_n**2)) == pytest.approx(2e-3, rel=0.03)
    assert abs(errors_n.mean()) < 4 * 2e-3 / math.sqrt(20_000)
    assert abs(np.corrcoef(errors_n[1:], errors_n[:-1])[0, 1]) < 4 / math.sqrt(20_000)


@pytest.mark.parametrize("order", [1, 2, 4])
def test_a_ramp_lags_by_the_filters_delay(order: int) -> None:
    under_test = film(filter="40 Hz", filter_order=order)
    slope_n_per_s = 0.5
    for tick in range(1000):
        reading_n = under_test.read(slope_n_per_s * tick * TICK_S)
    # The group delay of a Butterworth low-pass at 0 Hz is Σ 2 sin θ / ω over half of its poles.
    thetas = (2 * np.arange(order) + 1) * math.pi / (2 * order)
    delay_s = float(np.sin(thetas).sum()) / (2 * math.pi * 40)
    assert reading_n == pytest.approx(slope_n_per_s * (0.999 - delay_s), rel=1e-9)


@pytest.mark.parametrize(
    ("keys", "step_n"),
    [
        ({"sensitivity": "44 mV/N"}, 20 / 2**16 / 0.044),
        ({}, 20 / 2**16 / (0.3 / (2 * math.pi * 9e-3))),
        ({"sensitivity": "44 mV/N", "adc_range": "1 V"}, 2 / 2**16 / 0.044),
    ],
    ids=["Fig. 4", "eq 21", "Fig. 4 over 1 V"],
)
def test_an_adc_reads_in_whole_steps(keys: dict[str, object], step_n: float) -> None:
    forces_n = np.linspace(0.1, 0.2, 501)
    under_test = film(adc_bits=16, **keys)
    read_n = np.array([under_test.read(force_n) for force_n in forces_n.tolist()])
    assert np.abs(read_n / step_n - np.rint(read_n / step_n)).max() < 1e-6
    assert 0.4 * step_n < np.abs(read_n - forces_n).max() <= step_n / 2 * (1 + 1e-9)
    noise_n = table(adc_bits=16, **keys).noise_with_adc_n
    assert noise_n == pytest.approx(step_n / math.sqrt(12))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_force_beyond_the_adcs_range_reads_as_the_end_of_the_range(sign: int) -> None:
    under_test = film(sensitivity="1 V/N", adc_bits=8, adc_range="2 V")
    assert under_test.read(sign * 50.0) == (2 - 4 / 2**8 if sign > 0 else -2)
    under_test.read(sign * 1.9)
    assert under_test.at_range is not None
    assert (under_test.at_range.times, under_test.at_range.ticks) == (1, 1)
    assert film().at_range is None


@pytest.mark.parametrize("keys", [{}, {"noise": "1 mN"}, {"filter": "40 Hz"}, {"adc_bits": 16}])
@pytest.mark.parametrize("force_n", [math.nan, math.inf, -math.inf])
def test_a_force_that_is_no_number_stays_so(keys: dict[str, object], force_n: float) -> None:
    under_test = film(**keys)
    under_test.read(0.3)
    assert not math.isfinite(under_test.read(force_n))
    assert math.isfinite(under_test.read(0.3))
