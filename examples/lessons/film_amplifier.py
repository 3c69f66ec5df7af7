"""
A film's amplifier
==================

A PVDF film is a source of charge: 33 pC for each newton across its thickness. A charge amplifier
turns that into volts, and a second stage fits them to a converter. This lesson computes the
corners of the amplifier in "Build a bench" from its resistors and capacitors, gives them to
the model of the sensing chain, and shows what the chain does to sines and to a pulse.
"""

# %%
# From parts to corners
# ---------------------
# The gigohm discharges the capacitor beside it: slower changes are lost. The second stage's
# capacitor makes it slower than its resistor alone.

from math import pi

COULOMBS_PER_N = 33e-12
first_ohm, first_f = 1e9, 1e-9
second_ohm, second_f, input_ohm = 510e3, 3.3e-9, 10e3

slowest_hz = 1 / (2 * pi * first_ohm * first_f)
fastest_hz = 1 / (2 * pi * second_ohm * second_f)
first_v_per_n, gain = COULOMBS_PER_N / first_f, second_ohm / input_ohm
volts_per_n = first_v_per_n * gain
print(f"lost below {slowest_hz:.2f} Hz, and above {fastest_hz:.0f} Hz")
print(f"{1e3 * first_v_per_n:.0f} mV/N, then {gain:.0f} times that: {volts_per_n:.2f} V/N")
print(f"range ±{2.5 / volts_per_n:.2f} N, one of 1024 counts {5e3 / 1024 / volts_per_n:.1f} mN")

# %%
# The chain's response to sines
# -----------------------------
# At a corner 71 % of the force is left.

import numpy as np

from protocol.wire.description import Channel
from sensing_node.conditioning import Conditioned, ConditioningScene
from sensing_node.sources.source import SampleSource

chain = ConditioningScene.model_validate(
    {
        "sensitivity": f"{volts_per_n} V/N",
        "charge_amplifier": f"{slowest_hz} Hz",
        "hold_down": "0.3 N",
        "anti_alias": f"{fastest_hz} Hz",
        "anti_alias_order": 1,
        "adc_bits": 10,
        "adc_range": "2.5 V",
    }
)


class Forces(SampleSource):
    """Forces that are known, a thousand a second."""

    period_ns, channels = 1_000_000, (Channel("pulse"),)

    def __init__(self, force_n):
        self.force_n = force_n

    def take(self, count):
        return self.force_n[:count, np.newaxis]


def conditioned(force_n):
    return Conditioned(Forces(force_n), chain).take(len(force_n))[:, 0]


def share(hz):
    """Return the share of a sine's amplitude that is left once the chain has settled."""
    angle = 2 * pi * hz * np.arange(60_000) / 1000
    waves = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)
    (sine, cosine, _), *_ = np.linalg.lstsq(waves[20_000:], conditioned(waves[:, 0])[20_000:])
    return np.hypot(sine, cosine)


waves_hz = [0.05, slowest_hz, 1.25, 10, 40, fastest_hz, 200]
for hz in waves_hz:
    print(f"{hz:7.2f} Hz: {share(hz):5.1%}")

# %%
# A pulse through it
# ------------------
# The preload is lost, and `hold_down` takes its place. The slow wave of the breath is smaller and
# comes early, and each beat droops a little. The second stage delays the pulse by a time that the
# model states, so that it is no error.

from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene
from sensing_node.scene import SensingScene, build_source

path = find_scene("radial")
source = build_source(load_section(path, "sensing", SensingScene), path.parent)
pulse_n = source.take(60_000)[:, 0]
delay_ms = Conditioned(Forces(pulse_n), chain).group_delay_ns * 1e-6
now_ms = np.arange(10_000, len(pulse_n) - 1000)
felt_n = np.interp(now_ms + delay_ms, np.arange(len(pulse_n)), conditioned(pulse_n))
pulse_n = pulse_n[now_ms]
off_n = felt_n - felt_n.mean() - pulse_n + pulse_n.mean()
beats_n = (off_n - np.convolve(off_n, np.ones(801) / 801, "same"))[1000:-1000]
print(f"delayed by {delay_ms:.1f} ms")
print(f"height {1e3 * np.ptp(pulse_n[:800]):.0f} mN")
print(f"off by {1e3 * off_n.std():.1f} mN RMS with the breath")
print(f"off by {1e3 * beats_n.std():.1f} mN RMS within a beat")

# %%
# The figure needs matplotlib; without it the figures above are the whole lesson.

from importlib.util import find_spec

if find_spec("matplotlib"):
    from matplotlib import pyplot as plt

    shown_s = np.arange(5000) / 1000
    plt.figure(figsize=(7, 3), layout="constrained")
    plt.plot(shown_s, pulse_n[:5000], label="at the wrist")
    plt.plot(shown_s, felt_n[:5000], label="behind the converter")
    plt.xlabel("time, s")
    plt.ylabel("force, N")
    plt.legend()
    plt.show()
