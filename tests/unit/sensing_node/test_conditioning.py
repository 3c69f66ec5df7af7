import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from protocol.config.scene import validate
from protocol.errors import SceneError
from protocol.summary.fields import Limited, Limits
from protocol.tactile import Film
from protocol.wire.description import Channel
from sensing_node.conditioning import Conditioned, ConditioningScene
from sensing_node.scene import SensingScene, build_source, describe_stream
from sensing_node.sources.source import SampleSource
from tests.support.refusals import refusal_of
from tests.support.streams import synthetic

RATE_HZ = 1000
CHARGE: dict[str, Any] = {"charge_amplifier": "0.1 Hz", "hold_down": "0.3 N"}
MAINS: dict[str, Any] = {"mains": "50 Hz"}
LOW_PASS: dict[str, Any] = {"anti_alias": "40 Hz"}
WHOLE = CHARGE | MAINS | LOW_PASS | {"adc_bits": 16}
# Ratio of 80 Hz to 40 Hz after the bilinear transform, somewhat more than an octave.
OCTAVE = math.tan(math.pi * 80 / RATE_HZ) / math.tan(math.pi * 40 / RATE_HZ)


class GivenSource(SampleSource):
    """A source of given values, with one column per channel."""

    def __init__(self, values: NDArray[np.float64], rate_hz: float = RATE_HZ) -> None:
        self._values = values.reshape(len(values), -1)
        self.period_ns = round(1e9 / rate_hz)
        self.channels = tuple(Channel(str(i)) for i in range(self._values.shape[1]))

    def take(self, count: int) -> NDArray[np.float64]:
        taken, self._values = self._values[:count], self._values[count:]
        return taken


def chain(values: NDArray[np.float64], rate_hz: float = RATE_HZ, **keys: object) -> Conditioned:
    scene = validate(keys, ConditioningScene, "scene")
    return Conditioned(GivenSource(values, rate_hz), scene)


def conditioned(values: NDArray[np.float64], **keys: object) -> NDArray[np.float64]:
    """Return the chain's output for a force, both of shape (samples,)."""
    return chain(values, **keys).take(len(values)).ravel()


def gain(frequency_hz: float, **keys: object) -> float:
    """Return the settled chain's gain for a sine on 0.5 N."""
    turns = frequency_hz * np.arange(40_000) / RATE_HZ
    tail = conditioned(0.5 + 0.1 * np.cos(2 * np.pi * turns), **keys)[20_000:]
    tail = tail - tail.mean()
    carrier = np.exp(-2j * np.pi * turns[20_000:])
    # At half the rate, a sine and its mirror image are one.
    images = 1 if frequency_hz == RATE_HZ / 2 else 2
    return float(abs(images * np.mean(tail * carrier)) / 0.1)


def pulse(seconds: float, **keys: object) -> NDArray[np.float64]:
    return synthetic(preset="paper", **keys).take(round(seconds * RATE_HZ)).ravel()


@settings(deadline=None, max_examples=25)
@given(st.lists(st.integers(0, 400), max_size=8))
def test_the_output_does_not_depend_on_the_blocks(counts: list[int]) -> None:
    force_n = np.column_stack([pulse(2, noise="5 mN", seed=seed) for seed in (1, 2)])
    together = chain(force_n, **WHOLE).take(len(force_n))
    under_test = chain(force_n, **WHOLE)
    parts = np.concatenate([under_test.take(count) for count in (*counts, len(force_n))])
    np.testing.assert_array_equal(parts, together)


def test_each_channel_has_a_chain_of_its_own_and_an_ecg_passes_unchanged() -> None:
    alone = [pulse(2, noise="5 mN", seed=seed) for seed in (1, 2)]
    ecg_mv = np.sin(np.arange(2000))
    source = GivenSource(np.column_stack([alone[0], ecg_mv, alone[1]]))
    source.channels = (Channel("cun"), Channel("announce", "mV"), Channel("chi"))
    scene = validate(WHOLE, ConditioningScene, "scene")
    under_test = Conditioned(source, scene)
    together = np.concatenate([under_test.take(count) for count in (7, 500, 2000)])
    np.testing.assert_array_equal(together[:, 0], conditioned(alone[0], **WHOLE))
    np.testing.assert_array_equal(together[:, 2], conditioned(alone[1], **WHOLE))
    np.testing.assert_array_equal(together[:, 1], ecg_mv)


@pytest.mark.parametrize(
    ("keys", "frequency_hz", "expected"),
    [
        (CHARGE, 0.1, math.sqrt(0.5)), (CHARGE, 1.0, 1 / math.hypot(1, 0.1)), (CHARGE, 20.0, 1.0),
        (MAINS, 50.0, 0.0), ({"mains": "60 Hz"}, 60.0, 0.0), (MAINS, 60.0, 0.965),
        (MAINS, 10.0, 1.0),
        # −3 dB at f with f − 50²/f = ±50/Q, as for an analogue notch.
        (MAINS, 52.562, math.sqrt(0.5)),
        (MAINS | {"mains_quality": 2}, 39.0388, math.sqrt(0.5)),
        # A mains frequency that is 0.2 Hz higher.
        (MAINS, 50.2, 0.0797),
        (MAINS | {"mains_quality": 30}, 50.2, 0.233), (LOW_PASS, 40.0, math.sqrt(0.5)),
        (LOW_PASS, 5.0, 1.0),
        (LOW_PASS, 80.0, 1 / math.hypot(1, OCTAVE**4)),
        (LOW_PASS | {"anti_alias_order": 1}, 80.0, 1 / math.hypot(1, OCTAVE)),
        (LOW_PASS | {"anti_alias_order": 8}, 80.0, 1 / math.hypot(1, OCTAVE**8)),
        (LOW_PASS, 500.0, 0.0), (CHARGE | MAINS | LOW_PASS, 50.0, 0.0),
    ],
)  # fmt: skip
def test_the_gain_at_a_frequency(
    keys: dict[str, Any], frequency_hz: float, expected: float
) -> None:
    assert gain(frequency_hz, **keys) == pytest.approx(expected, rel=0.01, abs=1e-4)


@pytest.mark.parametrize(
    ("keys", "force_n"), [({}, 0.7), (MAINS, 0.7), (LOW_PASS, 0.7), (CHARGE, 0.3)]
)
def test_a_steady_force_passes_or_is_replaced_by_the_hold_down_force(
    keys: dict[str, Any], force_n: float
) -> None:
    np.testing.assert_allclose(conditioned(np.full(500, 0.7), **keys), force_n, rtol=1e-9)


@pytest.mark.parametrize(
    ("keys", "volts_per_newton"),
    [
        ({}, 0.044),
        ({"sensitivity": "2 V/N"}, 2.0),
        ({"film_radius": "8 mm"}, Film(8e-3).volts_per_newton),
    ],
)
def test_the_output_is_in_newtons_in_steps_of_the_adc(
    keys: dict[str, Any], volts_per_newton: float
) -> None:
    force_n = pulse(2)
    assert chain(force_n, **keys).group_delay_ns == 0
    np.testing.assert_allclose(conditioned(force_n, **keys), force_n, rtol=1e-12)
    read_n = conditioned(force_n, **keys, adc_bits=12, adc_range="5 V")
    step_n = 10 / 4096 / volts_per_newton
    assert np.abs(read_n - force_n).max() <= 0.5 * step_n * (1 + 1e-9)
    codes = read_n / step_n
    np.testing.assert_allclose(codes, np.rint(codes), atol=1e-6)


def test_samples_beyond_the_adcs_range_are_counted_and_reported() -> None:
    force_n = np.array([0.0, 0.9, 1.1, -1.1, 0.5])
    under_test = chain(force_n, sensitivity="1 V/N", adc_bits=16, adc_range="1 V")
    assert under_test.notes() == GivenSource(force_n).notes() == []
    read_n = np.concatenate([under_test.take(3), under_test.take(2)]).ravel()
    assert under_test.limits().adc == Limited(1, pytest.approx(0.002), 0.4)
    assert GivenSource(force_n).limits() == chain(force_n).limits() == Limits()
    assert under_test.notes() == ["2 samples beyond the ADC's range"]
    np.testing.assert_allclose(read_n, [0, 0.9, 1, -1, 0.5], atol=1e-4)


def best_shift_ms(force_n: NDArray[np.float64], delayed_n: NDArray[np.float64]) -> float:
    """Return the shift with the least RMSE of the two without their means."""
    t_ms = np.arange(len(force_n), dtype=np.float64)
    curve = CubicSpline(t_ms, delayed_n)
    middle = slice(100, -100)
    shifts_ms = np.arange(0, 70, 0.1)
    errors_n = [np.std(curve(t_ms[middle] + s) - force_n[middle]) for s in shifts_ms]
    return float(shifts_ms[np.argmin(errors_n)])


@pytest.mark.parametrize(
    ("keys", "delay_ms"),
    [
        (LOW_PASS, 10.5), (LOW_PASS | {"anti_alias_order": 1}, 3.9),
        ({"anti_alias": "20 Hz"}, 21.9),
        ({"anti_alias": "15 Hz", "anti_alias_order": 8}, 58.2),
        ({"anti_alias": "200 Hz", "anti_alias_order": 2}, 1.1), (MAINS, 0.3),
        (MAINS | {"mains_quality": 1}, 3.5), (MAINS | LOW_PASS, 10.8), (CHARGE, 0.0),
        (WHOLE | {"adc_bits": 24}, 10.8),
    ],
)  # fmt: skip
def test_the_stated_delay_is_the_shift_that_fits_the_pulse_best(
    keys: dict[str, Any], delay_ms: float
) -> None:
    # The charge amplifier needs this time to reach the mean.
    force_n = pulse(20)
    under_test = chain(force_n, **keys)
    stated_ms = under_test.group_delay_ns * 1e-6
    assert stated_ms == pytest.approx(delay_ms, abs=0.3)
    best_ms = best_shift_ms(force_n[12_000:], under_test.take(20_000).ravel()[12_000:])
    assert stated_ms == pytest.approx(best_ms, abs=1.0 if "charge_amplifier" in keys else 0.2)


def sensing(conditioning: dict[str, Any], rate: str = "1 kHz") -> SensingScene:
    source = {"kind": "synthetic", "rate": rate}
    return validate({"source": source, "conditioning": conditioning}, SensingScene, "x: [sensing]")


def test_the_stream_states_the_chains_delay() -> None:
    scene = sensing(WHOLE)
    source = build_source(scene, Path())
    assert isinstance(source, Conditioned)
    assert describe_stream(scene, source).group_delay_ns == source.group_delay_ns > 10_000_000


@pytest.mark.parametrize("key", ["anti_alias", "mains"])
def test_a_corner_above_half_the_rate_is_refused(key: str) -> None:
    with pytest.raises(SceneError) as caught:
        build_source(sensing({key: "50 Hz"}, rate="100 Hz"), Path())
    assert str(caught.value) == (
        f"[sensing.conditioning] {key}: 50 Hz is not below half the source's rate, 50 Hz;"
        " lower it or leave it out"
    )
    build_source(sensing({key: "50 Hz"}, rate="101 Hz"), Path())


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"charge_amplifier": "0.1 Hz"}, "conditioning: charge_amplifier loses the static force"),
        ({"hold_down": "0.3 N"}, "conditioning: hold_down needs charge_amplifier"),
        ({"mains_quality": 5}, "conditioning: mains_quality needs mains"),
        ({"anti_alias_order": 2}, "conditioning: anti_alias_order needs anti_alias"),
        ({"adc_range": "5 V"}, "conditioning: adc_range needs adc_bits"),
        ({"sensitivity": "1 V/N", "film_radius": "8 mm"}, "give one of them"),
    ],
)
def test_a_wrong_table_is_refused_in_one_line(keys: dict[str, Any], message: str) -> None:
    line = refusal_of(SceneError, sensing, keys)
    assert line.startswith("x: [sensing] conditioning")
    assert message in line
