"""Means of a channel's samples over steps of 5 ms. Pure."""

from protocol.wire.messages import ChannelSamples

STEP_NS = 5_000_000
STEP_S = STEP_NS * 1e-9
# Over a longer gap the means begin anew; shorter ones are interpolated.
MAX_GAP_NS = 100_000_000
# Frames are averaged after this time, within which they may change places.
HELD_NS = 100_000_000
# Samples that are closer together than this are averaged in groups first, which is quicker.
GROUP_NS = 500_000


class StepMeans:
    """Means over the steps from `begin_ns` on, frame by frame."""

    def __init__(self, begin_ns: int) -> None:
        self.begin_ns = begin_ns
        # Frames that are not averaged yet, in order of time.
        self._frames: list[ChannelSamples] = []
        self._newest_ns = begin_ns
        # The last sample that was averaged, and the present step: its end, and the integral of the
        # force over it so far.
        self._t_ns, self._force_n = float(begin_ns), 0.0
        self._end_ns, self._area = float(begin_ns + STEP_NS), 0.0
        self._any = False

    def follows(self, samples: ChannelSamples) -> bool:
        """Return whether a frame follows the others without a long gap."""
        return samples.times_ns[0] - self._newest_ns <= MAX_GAP_NS + samples.period_ns

    def add(self, samples: ChannelSamples) -> list[float]:
        """Take a frame, and return the means of the steps that it completes.

        A frame that comes too late, or again, is ignored.
        """
        first_ns, frames = samples.times_ns[0], self._frames
        place = len(frames)
        while place and first_ns <= frames[place - 1].times_ns[0]:
            place -= 1
        repeated = place < len(frames) and frames[place].times_ns[0] == first_ns
        if repeated or (self._any and first_ns <= self._t_ns):
            return []
        frames.insert(place, samples)
        self._newest_ns = max(self._newest_ns, samples.times_ns[-1])
        means: list[float] = []
        while frames and frames[0].times_ns[0] <= self._newest_ns - HELD_NS:
            self._average(frames.pop(0), means)
        return means

    def _average(self, samples: ChannelSamples, means: list[float]) -> None:
        """Integrate over a frame's samples, joined by straight lines."""
        times, forces_n = samples.times_ns, samples.forces_n
        if not self._any:
            # The force before the first sample is assumed to be the first one.
            self._any, self._force_n = True, forces_n[0]
        group = GROUP_NS // samples.period_ns
        if group < 2:
            for t_ns, force_n in zip(times, forces_n, strict=True):
                self._extend(t_ns, force_n, means)
            return
        for first in range(0, len(times), group):
            values = forces_n[first : first + group]
            middle_ns = times[first] + 0.5 * (len(values) - 1) * samples.period_ns
            self._extend(middle_ns, sum(values) / len(values), means)

    def _extend(self, t_ns: float, force_n: float, means: list[float]) -> None:
        """Extend the integral to a sample; append the means of the steps that end before it."""
        before_ns, before_n = self._t_ns, self._force_n
        if t_ns >= self._end_ns:
            slope = (force_n - before_n) / (t_ns - before_ns)
            while t_ns >= self._end_ns:
                end_ns, end_n = self._end_ns, force_n - (t_ns - self._end_ns) * slope
                area = self._area + 0.5 * (before_n + end_n) * (end_ns - before_ns)
                means.append(area / STEP_NS)
                before_ns, before_n = end_ns, end_n
                self._end_ns, self._area = end_ns + STEP_NS, 0.0
        self._area += 0.5 * (before_n + force_n) * (t_ns - before_ns)
        self._t_ns, self._force_n = t_ns, force_n
