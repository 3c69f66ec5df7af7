"""A device's clock against the host's, from the device's timestamps and when they arrived.

Nothing can be asked of such a device, and what it sends comes late, in batches, never early. So
arrival minus device time has a lower edge; the clock is a line along it. What the line cannot
tell from the clock's offset is the least delay on the way, which stays in the times it gives.
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
# Times a device cannot be early: less is noise, more, often in a row, another clock.
STEP_MARGIN_NS = 20_000_000
STEP_AFTER = 3
# So late for so many blocks is no delay on a cable.
LATE_NS = 500_000_000
LATE_BLOCKS = 4
ROUNDS = 3


class DeviceClock:
    """Follows a device's clock. Pure: times come in, in the order of arrival; all ns.

    steps: how often the device's clock has jumped or begun anew; the estimate then starts afresh.
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
        """Half a second has been seen: times are good to the usual spread of the delays."""
        return len(self._edge) >= READY_AFTER

    @property
    def skew_ppm(self) -> float:
        """How much faster the device's clock runs than the host's, in parts per million."""
        return (1 / (1 + self._skew) - 1) * 1e6

    def host_ns(self, device_ns: int) -> int:
        """The host's clock at a time of the device's; before any observation, that time itself."""
        return device_ns + self._offset_ns + round(self._skew * (device_ns - self._reference_ns))

    def observe(self, device_ns: int, arrival_ns: int) -> None:
        """What was stamped `device_ns` arrived at `arrival_ns`.

        What arrived before it was stamped is set aside, until enough in a row say that the
        device's clock has jumped; a time before the last one says so at once.
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
        """Begin with one observation."""
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
        # Kept as differences, which are exact as floats whatever the clocks' own numbers are.
        since_ns = float(device_ns - self._base_device_ns)
        drift_ns = float(arrival_ns - device_ns - self._base_offset_ns)
        self._edge.append((since_ns, drift_ns))
        self._fit()

    def _fit(self) -> None:
        """A line along the blocks' earliest arrivals; the later a block, the less it counts."""
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
