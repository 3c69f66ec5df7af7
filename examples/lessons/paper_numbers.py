"""
The paper's numbers
===================

Dargahi, Xie and Ji (Mechatronics 18, 2008, 195-207) sense a pulse by a PVDF film on the wrist,
and reproduce it by a stepper that presses a rubber layer under a film at the finger. This lesson
computes the paper's figures from its equations, runs its controller on its own model of the
actuator and on a physical stepper, and compares.
"""

# %%
# Film and rubber
# ---------------
# Equation 21 gives a film's voltage for a force at its rim; equations 16 to 20 give the strain in
# the rubber below it. Tables 1 and 3 have the values. Both layers are equal, so that equal strain
# means equal force.

from protocol.tactile import Calibration, ElasticLayer, Film, matching_force_ratio

wrist, finger = Film(radius_m=8e-3), Film(radius_m=9e-3)
layer = ElasticLayer(young_modulus_pa=0.05e9, thickness_m=2e-3, poisson_ratio=0.5)
print(f"film at the wrist: {wrist.volts_per_newton:.2f} V/N")
print(f"film at the finger: {finger.volts_per_newton:.2f} V/N")
print(f"layer: strain {layer.strain_per_newton:.4e} per newton")
print(f"force ratio for equal strain: {matching_force_ratio(layer, layer):.2f}")

# %%
# Where the paper contradicts itself
# ----------------------------------
# Figure 4 calibrates the film at the finger: about 110 mV at 2.5 N. Equation 21 gives over a
# hundred times more; a charge amplifier, whose gain is not printed, stands between them.
#
# The experiment's error is printed twice, as a strain and as a force. By Table 3 the two differ.

print(f"eq 21 over Fig. 4: {finger.volts_per_newton / Calibration().volts_per_newton:.0f}")
printed_strain, printed_force_n = 5.7802e-8, 0.020863
strain_as_mn = 1e3 * abs(layer.force(printed_strain))
print(f"RMSE as a strain: {strain_as_mn:.1f} mN; as a force: {1e3 * printed_force_n:.1f} mN")

# %%
# The pulse and its spectrum
# --------------------------
# The preset "paper" of the synthetic source was fitted to the shares of energy in Fig. 16. A run
# of the scene ``paper`` has the force at the wrist, one value for each tick of the display. A
# film does not pass the preload; the mean that is left, and Welch's settings, belong to the fit.

import numpy as np
from matplotlib import pyplot as plt
from scipy.signal import welch

import telepulse

on_model = telepulse.simulate("paper", seconds=20)
pulse_n = on_model.wrist_n[~np.isnan(on_model.wrist_n)][: int(15 * on_model.rate_hz)]
pulse_n += 0.034 * pulse_n.std() - pulse_n.mean()
hz, power = welch(pulse_n, on_model.rate_hz, "hamming", 3333, 1666, 4096, detrend=False)
shares = np.cumsum(power) / power.sum()
published = {20.0: 0.997, 10.0: 0.894, 5.0: 0.574, 1.0: 0.124, 0.4: 0.048}
for below_hz, share in published.items():
    ours = shares[np.searchsorted(hz, below_hz) - 1]
    print(f"energy below {below_hz:4} Hz: paper {share:6.1%}, here {ours:6.1%}")

# %%
plt.figure(figsize=(7, 3), layout="constrained")
plt.plot(hz, 100 * shares, label="scene paper")
plt.plot(published.keys(), [100 * s for s in published.values()], "o", label="Fig. 16")
plt.xlim(0, 25)
plt.xlabel("frequency, Hz")
plt.ylabel("energy below it, %")
plt.legend()
plt.show()

# %%
# Its controller, and a stepper
# -----------------------------
# ``paper`` has the gains of Table 5 and the second-order model of equation 22; ``bench`` has the
# same pulse on a stepper with steps, a top speed and a contact, driven by feed-forward and an
# observer. Aligned is the error of the force loop alone, without the delay.

runs = {"paper": on_model}
runs |= {name: telepulse.simulate(name, seconds=20) for name in ("bench", "real_bench")}
for name, run in runs.items():
    errors = run.summary.force_rmse_n
    print(f"{name:10}: aligned {1e3 * errors.aligned:.3f} mN of a pulse of 300 mN")
print(f"the paper's experiment: {1e3 * printed_force_n:.1f} mN")

# %%
runs["paper"].plot(begin_s=10, end_s=12.5)
plt.show()

# %%
# ``telepulse paper`` does this for every figure and table, with the reasons for each difference.
