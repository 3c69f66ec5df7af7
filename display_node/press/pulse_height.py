"""Levels of the pulse, beat by beat, for the model of the tissue. Pure."""

from collections import deque
from typing import Final

from display_node.press.learnt_beats import BeatLevels

# Levels are taken of a beat in which the hold-down stays within this share and force.
STEADY_SHARE, STEADY_N = 0.04, 0.01
# Time before and after the peak of which the quartiles are taken. It does not depend on the
# interval of the beat, which varies more than the time of systole.
AROUND_NS: Final = 200_000_000
# Frames of which a foot is the mean.
FOOT: Final = 5


class PulseHeight:
    """Levels of each beat at a steady hold-down: foot, three quartiles, and peak.

    A peak is the highest value within half a beat before and after it. The foot is the lowest one
    before it: it belongs to the same upstroke, so a respiratory wave changes both alike.
    """

    def __init__(self) -> None:
        self._means: deque[tuple[int, float, float]] = deque()

    def add(
        self, hold_down_n: float, pulse_n: float, now_ns: int, beat_ns: int
    ) -> BeatLevels | None:
        """Take a frame's means; return the levels of a beat that is complete, or None.

        Parameters
        ----------
        hold_down_n, pulse_n
            Means of the hold-down and of the film.
        now_ns
            Time of the frame.
        beat_ns
            Usual time of a beat.
        """
        means = self._means
        if means and now_ns - means[-1][0] > beat_ns // 8:
            means.clear()
        means.append((now_ns, hold_down_n, pulse_n))
        while now_ns - means[0][0] > beat_ns:
            means.popleft()
        if now_ns - means[0][0] < beat_ns - beat_ns // 16:
            return None
        at = len(means) // 2
        pulses_n = [each[2] for each in means]
        high_n = pulses_n[at]
        if high_n <= max(*pulses_n[:at], *pulses_n[at + 1 :]):
            return None
        mean_n = sum(each[1] for each in means) / len(means)
        moved_n = max(abs(each[1] - mean_n) for each in means)
        if moved_n > STEADY_SHARE * abs(mean_n) + STEADY_N:
            return None
        peak_ns = means[at][0]
        around = sorted(each[2] for each in means if abs(each[0] - peak_ns) < AROUND_NS)
        # The lowest of many values would be that of the noise, where the foot is flat.
        sums = [sum(pulses_n[first : first + FOOT]) for first in range(at - FOOT + 1)]
        low_n = min(sums) / FOOT
        low_ns = means[sums.index(min(sums)) + FOOT // 2][0]
        first, second, third = (around[len(around) * part // 4] for part in (1, 2, 3))
        levels_n = low_n, first, second, third, high_n
        return BeatLevels(peak_ns * 1e-9, (peak_ns - low_ns) * 1e-9, mean_n, moved_n, levels_n)
