"""
Bring your recording
====================

A display plays any recorded pulse as if a wrist was there. This lesson writes one, as an
instrument might: a CSV file with a pulse oximeter's numbers, which are no forces.
Replace it by yours.
"""

# %%
# A file
# ------
# One column for each channel, a name in the first line, one row for each sample.

import tempfile
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

import telepulse

RATE_HZ = 250
generator = np.random.default_rng(1)
times_s = np.arange(0, 60, 1 / RATE_HZ)
# Each beat is longer or shorter than the last one.
beats_s = np.cumsum(0.85 + 0.04 * generator.standard_normal(80))
phase = np.interp(times_s, beats_s, np.arange(80), left=0) % 1
light = (
    500 - 40 * np.exp(-(((phase - 0.25) / 0.12) ** 2)) - 14 * np.exp(-(((phase - 0.6) / 0.1) ** 2))
)
light += 0.3 * generator.standard_normal(len(light))

folder = Path(tempfile.mkdtemp())
np.savetxt(folder / "oximeter.csv", light, header="light", comments="", fmt="%.3f")

# %%
# A scene
# -------
# More blood lets less light through: ``inverted``. The numbers have no unit of force; ``raw``
# scales them to the height that the finger is to feel.

source = {
    "kind": "recording",
    "path": str(folder / "oximeter.csv"),
    "column": "light",
    "rate": f"{RATE_HZ} Hz",
    "unit": "raw",
    "inverted": True,
    "peak_to_peak": "0.3 N",
    "repeat": "once",
}
scene = telepulse.load_scene("radial", sensing={"source": source}, link="delay=30ms,jitter=8ms")
run = telepulse.simulate(scene, seconds=40)
run.plot(begin_s=20, end_s=24)
plt.show()

# %%
# A notebook shows a run by what was felt, and by its middle:

run

# %%
# The mean beat at the wrist and at the finger, with one standard deviation to either side:

run.plot_beat()
plt.show()

# %%
# A file that states its rate
# ---------------------------
# An EDF file, or a record of PhysioNet, states rate and unit itself, so ``source`` is its path
# alone. The package edfio writes one from an array. A unit that is neither force nor pressure is
# scaled so that the median beat is felt with 0.3 N.

import edfio

signal = edfio.EdfSignal(-light, RATE_HZ, label="PLETH", physical_dimension="NU")
edfio.Edf([signal]).write(folder / "oximeter.edf")
of_record = telepulse.simulate(source=folder / "oximeter.edf", seconds=10)
beats = of_record.beats()
print(f"median height at the wrist {np.median([beat.height_n for beat in beats]):.2f} N")
print(f"median rate {60 / np.median([beat.interval_s for beat in beats]):.0f} /min")

# %%
# The figures
# -----------
# ``summary`` has what the nodes print. ``to_dataframe`` has the arrays, ``rate_hz`` rows a second.

errors = run.summary.force_rmse_n
print(f"aligned {1e3 * errors.aligned:.2f} mN, in phase {1e3 * errors.in_phase:.2f} mN")
frame = run.to_dataframe()
rows = round(5 * run.rate_hz)
print(frame[["t_s", "wrist_n", "felt_n", "delay_s", "predicted"]].iloc[rows::rows])

# %%
# Beat by beat
# ------------
# ``find_beats`` is what a display shows of each beat, for any array: onset, systolic peak,
# dicrotic notch, height, and a quality from 0 to 1 by its likeness to the beats before. Of a run,
# ``beats`` finds them.

beats = telepulse.find_beats(-light, RATE_HZ)
for beat in beats[10:15]:
    print(
        f"onset {beat.onset_ns * 1e-9:6.3f} s, upstroke {1e3 * beat.upstroke_s:3.0f} ms,"
        f" height {beat.height_n:4.1f}, rate {60 / beat.interval_s:3.0f} /min,"
        f" quality {beat.quality:.2f}"
    )

# %%
true_s = np.diff(beats_s)
found_s = [beat.interval_s for beat in beats]
print(f"variability: {1e3 * np.std(found_s):.0f} ms found, {1e3 * np.std(true_s):.0f} ms drawn")
