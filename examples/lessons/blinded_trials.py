"""
Can a finger tell?
==================

``telepulse experiment`` writes a log of blinded trials, one JSON object a line. This lesson reads
such logs with pandas: the shares of right answers with exact intervals, the threshold, and the
number of trials that an effect takes to show. Its subjects are simulated; replace their logs by
those of people.
"""

# %%
# Two sessions
# ------------
# A and B are felt, then X, which is one of them: which one? One condition buffers the link's
# delay, the other predicts all of it with the least of the predictors.

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from scipy.special import ndtr
from scipy.stats import binom, binomtest

SESSION = """
scene = "radial"
kind = "abx"
trials = 8
interval = "0.5 s"
seed = 1

[[conditions]]
name = "buffered"
link = "delay=40ms,jitter=5ms,loss=1%"
compensation = "auto"
predictor = "linear"

[[conditions]]
name = "all predicted"
link = "delay=40ms,jitter=5ms,loss=1%"
compensation = "0 ms"
predictor = "linear"
"""

folder = Path(tempfile.mkdtemp())
(folder / "session.toml").write_text(SESSION)
for subject, threshold in {"anna": "2 %", "bo": "20 %"}.items():
    command = f"experiment run session.toml --log {subject}.jsonl --observer".split()
    subprocess.run(
        [sys.executable, "-m", "telepulse", *command, threshold],
        cwd=folder,
        check=True,
        stdout=subprocess.DEVNULL,
    )

# %%
# The logs
# --------
# A trial that the machine spoilt is left out. In a catch trial, which has no condition, no answer
# is right. Pool only logs of one scene, of one kind of interval, and either of people or of
# observers: the first line of each log has all three.

logs = {path.stem: pd.read_json(path, lines=True) for path in sorted(folder.glob("*.jsonl"))}
trials = pd.concat(
    lines[(lines["line"] == "trial") & lines["condition"].notna()].assign(subject=subject)
    for subject, lines in logs.items()
)
spoilt = trials["spoilt"] != ""
print(f"{len(trials)} trials, {spoilt.sum()} of them spoilt")
trials = trials[~spoilt]

# %%
# Right answers
# -------------
# The interval is exact (Clopper and Pearson). p is the probability of as many right answers or
# more by guessing; it is not corrected for the number of rows.


def summary(group: pd.DataFrame) -> pd.Series:
    hits, count = int(group["correct"].sum()), len(group)
    guessed = binomtest(hits, count, 0.5, alternative="greater")
    interval = binomtest(hits, count).proportion_ci(0.95, method="exact")
    found = {"right": hits, "of": count, "low": interval.low, "high": interval.high}
    return pd.Series(found | {"p": guessed.pvalue})


shares = pd.DataFrame(
    {key: summary(group) for key, group in trials.groupby(["condition", "subject"])}
)
print(shares.T.round(3).to_string())

# %%
# The threshold
# -------------
# A differencing observer feels the force error of an interval in units of its threshold, with
# noise of deviation 1, and takes X for the nearer one of A and B (Macmillan and Creelman,
# *Detection Theory*, ch. 9). The threshold, where d' is 1, is that of the greatest likelihood; its
# 95 % interval is where the logarithm of the likelihood is less than 1.92 below the greatest.


def probability_of_a(a: float, b: float, x: float, threshold: np.ndarray) -> np.ndarray:
    apart = (a - b) / threshold / np.sqrt(2)
    aside = (x - (a + b) / 2) / threshold / np.sqrt(1.5)
    return ndtr(apart) * ndtr(aside) + ndtr(-apart) * ndtr(-aside)


tried = np.logspace(-4, 1, 2000)
figure, axes = plt.subplots()
for subject, group in trials.groupby("subject"):
    likelihood = np.zeros(len(tried))
    for trial in group.itertuples():
        of_a = probability_of_a(trial.error_a, trial.error_b, trial.error_x, tried)
        likelihood += np.log(np.maximum(of_a if trial.answer == "A" else 1 - of_a, 1e-300))
    likelihood -= likelihood.max()
    within = tried[likelihood > -1.92]
    best = tried[likelihood.argmax()]
    print(f"{subject}: {best:.1%} of the pulse's height ({within[0]:.1%} to {within[-1]:.1%})")
    axes.semilogx(100 * tried, likelihood, label=subject)
axes.axhline(-1.92, color="0.5", ls="--")
axes.set(xlabel="threshold, % of the pulse's height", ylabel="log likelihood", ylim=(-10, 0.5))
axes.legend()
plt.show()

# %%
# The number of trials
# --------------------
# The paper had six subjects, four of whom felt it close to a direct touch. So many trials are
# needed before a true share of right answers is told from guessing (p ≤ 5 %) four times of five.


def power(count: np.ndarray, share: float) -> np.ndarray:
    return binom.sf(binom.isf(0.05, count, 0.5), count, share)


print(f"six trials, if right two of three times: {power(np.array(6), 2 / 3):.1%}")
counts = np.arange(1, 2000)
for share in (2 / 3, 3 / 4, 9 / 10):
    print(f"right {share:.0%} of the time: {counts[power(counts, share) < 0.8][-1] + 1} trials")
