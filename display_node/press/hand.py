"""The hand that follows a yielding tip: its stiffness, and what the press will be. Pure.

While the tip yields, a stiff hand that follows it presses less. Its press returns within a second,
and the hold-down would be where the press was one way of the link ago. The tip's course is known,
so the change of the press until a set-point arrives is predicted from it.
"""

import math
from collections import deque
from typing import Final

from protocol.tissue import StiffeningLaw

# The hand follows with this time constant: a reflex takes some 0.1 s.
FOLLOWS_S: Final = 0.1
# The stiffness is learnt from changes over this time, and these changes of the distance between
# tip and hand; the assumed one counts as much as one such change.
LEARN_NS, SAMPLE_NS = 100_000_000, 10_000_000
LEAST_CHANGE_M: Final = 5e-5
TYPICAL_N_PER_M, STIFFEST_N_PER_M = 300.0, 1500.0
FORGET: Final = 0.995
# The prediction's steps, and its bounds: a share of the press.
STEP_S, MOST_AHEAD_S, MOST_SHARE = 0.02, 2.0, 0.3


class FollowingHand:
    """A hand that keeps its force by following the tip, learnt from reading and tip.

    stiffness_n_per_m: of finger and hand, against the distance by which it lags the tip.
    """

    def __init__(self) -> None:
        self._yielded_m = self._lag_m = 0.0
        self._last_ns: int | None = None
        # Press and lag of the last samples.
        self._samples: deque[tuple[int, float, float]] = deque()
        self._products = TYPICAL_N_PER_M * LEAST_CHANGE_M**2
        self._squares = LEAST_CHANGE_M**2
        self.stiffness_n_per_m = TYPICAL_N_PER_M

    def observe(self, press_n: float, yielded_m: float, now_ns: int) -> None:
        """Take the press without an average, and the distance by which the tip has yielded."""
        elapsed_s = 0.0 if self._last_ns is None else max(0, now_ns - self._last_ns) * 1e-9
        self._last_ns = now_ns
        self._lag_m += yielded_m - self._yielded_m
        self._lag_m *= math.exp(-elapsed_s / FOLLOWS_S)
        self._yielded_m = yielded_m
        samples = self._samples
        if samples and now_ns - samples[-1][0] < SAMPLE_NS:
            return
        samples.append((now_ns, press_n, self._lag_m))
        while now_ns - samples[0][0] > LEARN_NS:
            samples.popleft()
        _, first_n, first_m = samples[0]
        change_n, change_m = press_n - first_n, self._lag_m - first_m
        # A hand that presses more lags more: it moves by itself, and shows no stiffness.
        if abs(change_m) < LEAST_CHANGE_M or change_n * change_m > 0:
            return
        self._products = FORGET * self._products - change_n * change_m
        self._squares = FORGET * self._squares + change_m * change_m
        self.stiffness_n_per_m = min(self._products / self._squares, STIFFEST_N_PER_M)

    def most_gain(self, compliance_m_per_n: float, yield_s: float) -> float:
        """Return the largest predicted change for a change of the press without a duration.

        Tip and hand are low-pass and high-pass: their product passes at most the share
        FOLLOWS_S / (FOLLOWS_S + yield_s) of a sine, and both the lag now and the predicted one may
        contain it.
        """
        passed = FOLLOWS_S / (FOLLOWS_S + yield_s)
        return 2.0 * passed * self.stiffness_n_per_m * compliance_m_per_n

    def change_n(self, press_n: float, law: StiffeningLaw, yield_s: float, ahead_s: float) -> float:
        """Return by how much the press will have changed, if the hand means no other force.

        Parameters
        ----------
        press_n
            The press now.
        law
            Tissue by which the tip yields.
        yield_s
            Time constant of the tip.
        ahead_s
            Time until then.
        """
        tip_m, lag_m, stiffness = self._yielded_m, self._lag_m, self.stiffness_n_per_m
        meant_n = press_n + stiffness * lag_m
        toward = -math.expm1(-STEP_S / yield_s)
        kept = math.exp(-STEP_S / FOLLOWS_S)
        for _ in range(round(min(ahead_s, MOST_AHEAD_S) / STEP_S)):
            step_m = (law.depth_m(meant_n - stiffness * lag_m) - tip_m) * toward
            tip_m += step_m
            lag_m = (lag_m + step_m) * kept
        most_n = MOST_SHARE * press_n
        return min(max(meant_n - stiffness * lag_m - press_n, -most_n), most_n)
