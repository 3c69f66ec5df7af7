import math

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.scoring.roughness import RoughnessMeter
from protocol.summary.fields import Roughness

MS = 1_000_000
T0_NS = 1_700_000_000_000_000_000
Times = NDArray[np.int64]
Forces = NDArray[np.float64]


def metered(
    felt_n: Forces,
    sensed_n: Forces,
    block: int = 256,
    tick_ns: int = MS,
    shift_ns: Times | int = 0,
) -> RoughnessMeter:
    meter = RoughnessMeter()
    now_ns = T0_NS + np.arange(len(felt_n), dtype=np.int64) * tick_ns + shift_ns
    for start in range(0, len(felt_n), block):
        part = slice(start, start + block)
        meter.add(now_ns[part], felt_n[part], sensed_n[part])
    return meter


def wave_n(hz: float, amplitude_n: float = 0.001, count: int = 10_000) -> Forces:
    return np.asarray(amplitude_n * np.sin(2 * math.pi * hz * np.arange(count) * 1e-3))


@pytest.mark.parametrize(("hz", "share"), [(0.0, 0.0), (1.2, 0.0), (8, 0.0), (42, 1.0), (200, 1.0)])
def test_only_force_above_25_hz_is_roughness(hz: float, share: float) -> None:
    noise_n = wave_n(100)
    roughness = metered(0.3 + wave_n(hz, 0.1), noise_n).roughness
    assert roughness.sensed_n == pytest.approx(1e-3 / math.sqrt(2), rel=1e-3)
    assert roughness.felt_n == pytest.approx(share * 0.1 / math.sqrt(2), rel=0.01, abs=3e-5)


@pytest.mark.parametrize("block", [7, 100, 256, 10_000])
def test_the_ratio_is_of_energies_and_independent_of_the_size_of_blocks(block: int) -> None:
    pulse_n = wave_n(1.2, 0.1)
    roughness = metered(pulse_n + 3 * wave_n(60), pulse_n + wave_n(60), block).roughness
    assert roughness.energy_ratio == pytest.approx(9, rel=1e-3)
    felt_n, sensed_n = np.random.default_rng(1).standard_normal((2, 10_000))
    whole, parts = (metered(felt_n, sensed_n, size).roughness for size in (10_000, block))
    assert parts.energy_ratio == pytest.approx(whole.energy_ratio)


def test_a_gap_is_no_roughness() -> None:
    meter, ticks = RoughnessMeter(), np.arange(256, dtype=np.int64) * MS
    for part in range(20):
        # Each piece begins 0.1 s late, at another force.
        now_ns = T0_NS + part * 356 * MS + ticks
        level_n = np.full(256, 0.2 + 0.1 * (part % 2))
        meter.add(now_ns, level_n, level_n)
    assert meter.roughness.felt_n == pytest.approx(0, abs=1e-12)


def test_ticks_around_an_unknown_force_are_not_counted() -> None:
    felt_n, sensed_n = wave_n(60), wave_n(60)
    felt_n[4000:5000] += np.random.default_rng(1).standard_normal(1000)
    sensed_n[4000:5000] = np.nan
    felt_n[6_000:6_100] = math.nan
    assert metered(felt_n, sensed_n).roughness.energy_ratio == pytest.approx(1)


def test_a_clock_correction_is_no_gap() -> None:
    ticks, wave = np.arange(10_000, dtype=np.int64), wave_n(60)
    meter = metered(2 * wave, wave, shift_ns=ticks % 3 * 200 + ticks // 256 * 2_000)
    assert meter.roughness.energy_ratio == pytest.approx(4, rel=1e-3)


def test_the_first_ticks_and_slow_ticks_have_no_roughness() -> None:
    assert metered(wave_n(60)[:150], wave_n(60)[:150]).roughness == Roughness()
    assert metered(wave_n(3), wave_n(3), tick_ns=20 * MS).roughness == Roughness()
