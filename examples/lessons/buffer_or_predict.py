"""
Buffer or predict?
==================

Over a network, each sample arrives late, by a different time. A display can wait and play the
pulse as it was (buffer), or play a forecast of the pulse now (predict). This lesson measures both
over a link with 40 ms of delay and 10 ms of jitter.

The perceived delay E (``compensation``) is how old the played instant of the pulse is. Two errors
follow: **aligned** compares the felt force with the pulse E earlier, **in phase** with the pulse
now.
"""

# %%
# One run
# -------
# With E = 20 ms, samples that take longer have not arrived when they are due: they are predicted.

import numpy as np
from matplotlib import pyplot as plt

import telepulse

LINK = "delay=40ms,jitter=10ms,loss=1%"
run = telepulse.simulate("radial", seconds=20, link=LINK, display={"compensation": "20 ms"})
print(f"predicted: {np.mean(run.predicted[run.played]):.0%} of the time")
run.plot(begin_s=15, end_s=17)
plt.show()

# %%
# The errors are computed from the arrays. The summary has the same ones, of the ticks at which a
# pulse was played at full strength.


def errors_mn(run: telepulse.Run) -> tuple[float, float]:
    """Return the RMS errors aligned and in phase, in mN."""
    due_n = run.first.force_ratio * run.wrist_n
    then_n = np.interp(run.t_s - run.delay_s, run.t_s, due_n)
    aligned_n = (run.felt_n - then_n)[run.played]
    in_phase_n = (run.felt_n - due_n)[run.played]
    return 1e3 * np.sqrt(np.nanmean(aligned_n**2)), 1e3 * np.sqrt(np.nanmean(in_phase_n**2))


aligned_mn, in_phase_mn = errors_mn(run)
print(f"aligned {aligned_mn:.2f} mN, in phase {in_phase_mn:.2f} mN")
summary = run.summary.force_rmse_n
print(f"summary: {1e3 * summary.aligned:.2f} mN, {1e3 * summary.in_phase:.2f} mN")

# %%
# All delays
# ----------
# ``linear`` continues the last samples in a straight line; ``stack`` learns the pulse. A finger
# notices a tenth of a pulse: 30 mN of 300 mN.

DELAYS_MS = (0, 20, 40, 60)
found = {
    predictor: [
        errors_mn(
            telepulse.simulate(
                "radial",
                seconds=15,
                link=LINK,
                display={"predictor": predictor, "compensation": f"{delay_ms} ms"},
            )
        )
        for delay_ms in DELAYS_MS
    ]
    for predictor in ("linear", "stack")
}
for predictor, errors in found.items():
    for delay_ms, (aligned, in_phase) in zip(DELAYS_MS, errors, strict=True):
        errors_text = f"{aligned:5.1f} mN aligned, {in_phase:5.1f} mN in phase"
        print(f"{predictor:6} E {delay_ms:2} ms: {errors_text}")

# %%
_, panels = plt.subplots(1, 2, sharex=True, sharey=True, figsize=(8, 3))
for axes, column, title in zip(panels, (0, 1), ("aligned", "in phase"), strict=True):
    for predictor, errors in found.items():
        axes.plot(DELAYS_MS, [each[column] for each in errors], "o-", label=predictor)
    axes.axhline(30, color="0.6", ls="--", label="noticed")
    axes.set(title=title, xlabel="perceived delay E, ms")
panels[0].set_ylabel("RMS error, mN")
panels[0].legend()
plt.show()

# %%
# Above the link's delay and jitter nothing is predicted, and more delay only adds to the error in
# phase. Below, the stack's forecast is closer than what buffering leaves. With ``compensation =
# "auto"``, the default, the display begins with the delay of the link and reduces it once its
# forecasts go unnoticed:

auto = telepulse.simulate("radial", seconds=30, link=LINK)
auto.plot_delay()
plt.show()
for begin_s in range(0, 30, 5):
    part = (auto.t_s >= begin_s) & (auto.t_s < begin_s + 5) & auto.played
    if part.any():
        print(f"{begin_s:2} to {begin_s + 5:2} s: E {1e3 * np.nanmean(auto.delay_s[part]):5.1f} ms")
