"""A device's clock against the host's, from the device's timestamps and their arrivals.

Such a device answers no requests. Its samples arrive late and in batches, never early, so arrival
minus device time has a lower edge, and the clock is a line along that edge. The least delay on the
way cannot be told from an offset of the clock; it remains in the times that are returned.
"""

from collections import deque

import numpy as np

from protocol.clock.offset_regression import fit_lines

BLOCK_NS = 250_000_000
KEEP = 256
READY_AFTER = 2
# Resonators of boards without a crystal are off by up to 0.5 %.
USUAL_SKEW = 2e-3
LEAST_NOISE_NS = 20_000.0
# Arrivals before their timestamp: less is noise; more, several times in a row, is another clock.
STEP_MARGIN_NS = 20_000_000
STEP_AFTER = 3
# No cable delays so much for so many blocks.
LATE_NS = 500_000_000
LATE_BLOCKS = 4
ROUNDS = 3


class DeviceClock:
    """Estimator of a device's clock. Pure: all times are arguments, in integer ns.

    Attributes
    ----------
    steps : int
        Number of steps or restarts of the device's clock; each starts the estimate again.
    """

    def __init__(self) -> None:
        self.steps = 0
        self._last_device_ns: int | None = None
        self._base_device_ns = self._base_offset_ns = 0
        self._reference_ns = self._offset_ns = 0
        self._skew = 0.0
        # The earliest arrivals, one a block: device time and arrival less device time.
        self._edge: deque[tuple[float, float]] = deque(maxlen=KEEP)
        self._block_began_ns = self._least_late_ns = 0
        self._least = (0, 0)
        self._early = self._late_blocks = 0

    @property
    def ready(self) -> bool:
        """True after half a second, when times are good to the usual spread of the delays."""
        return len(self._edge) >= READY_AFTER

    @property
    def skew_ppm(self) -> float:
        """Device over host clock rate, less 1, in parts per million."""
        return (1 / (1 + self._skew) - 1) * 1e6

    def host_ns(self, device_ns: int) -> int:
        """Return the host's clock at a device time; before any observation, that time itself."""
        return device_ns + self._offset_ns + round(self._skew * (device_ns - self._reference_ns))

    def observe(self, device_ns: int, arrival_ns: int) -> None:
        """Add a timestamp of the device and its arrival; call this in the order of arrival.

        An arrival before its timestamp is set aside; after several in a row the device's clock has
        stepped. A timestamp before the last one shows a step at once.
        """
        if self._last_device_ns is None:
            self._anchor(device_ns, arrival_ns)
        elif device_ns < self._last_device_ns:
            self._step(device_ns, arrival_ns)
        elif self.ready and arrival_ns < self.host_ns(device_ns) - STEP_MARGIN_NS:
            self._early += 1
            if self._early < STEP_AFTER:
                return
            self._step(device_ns, arrival_ns)
        self._early = 0
        self._last_device_ns = device_ns
        late_ns = arrival_ns - self.host_ns(device_ns)
        if late_ns < self._least_late_ns:
            self._least_late_ns, self._least = late_ns, (device_ns, arrival_ns)
        if arrival_ns - self._block_began_ns >= BLOCK_NS:
            self._close_block(arrival_ns)

    def _step(self, device_ns: int, arrival_ns: int) -> None:
        self.steps += 1
        self._anchor(device_ns, arrival_ns)

    def _anchor(self, device_ns: int, arrival_ns: int) -> None:
        """Start from one observation."""
        self._base_device_ns = self._reference_ns = self._last_device_ns = device_ns
        self._base_offset_ns = self._offset_ns = arrival_ns - device_ns
        self._skew = 0.0
        self._edge.clear()
        self._early = self._late_blocks = 0
        self._start_block(arrival_ns)

    def _start_block(self, now_ns: int) -> None:
        self._block_began_ns = now_ns
        self._least_late_ns = 1 << 63

    def _close_block(self, now_ns: int) -> None:
        device_ns, arrival_ns = self._least
        late_ns = self._least_late_ns
        self._start_block(now_ns)
        self._late_blocks = self._late_blocks + 1 if self.ready and late_ns > LATE_NS else 0
        if self._late_blocks >= LATE_BLOCKS:
            self._step(device_ns, arrival_ns)
        # Differences are exact as floats, whatever the clocks show.
        since_ns = float(device_ns - self._base_device_ns)
        drift_ns = float(arrival_ns - device_ns - self._base_offset_ns)
        self._edge.append((since_ns, drift_ns))
        self._fit()

    def _fit(self) -> None:
        """Fit a line along the blocks' earliest arrivals, with low weights for late blocks."""
        since_ns, drift_ns = np.array(self._edge).T
        weight = np.ones((len(since_ns), 1))
        noise_ns = np.array([LEAST_NOISE_NS])
        for _ in range(ROUNDS):
            line = fit_lines(since_ns, drift_ns[:, None], weight, noise_ns, USUAL_SKEW)
            late_ns = drift_ns - line.offset_ns - line.skew * (since_ns - line.middle_ns)
            usual_ns = LEAST_NOISE_NS + float(np.median(np.abs(late_ns)))
            weight = (1 / (1 + (np.maximum(late_ns, 0) / usual_ns) ** 2))[:, None]
        middle_ns = round(float(line.middle_ns[0]))
        self._reference_ns = self._base_device_ns + middle_ns
        self._offset_ns = self._base_offset_ns + round(float(line.at(middle_ns)[0]))
        self._skew = float(line.skew[0])
