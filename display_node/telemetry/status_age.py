"""Age of a display's newest status, which has no time stamp of its own. Pure."""

# The shortest transit is searched in windows of this length. Longer ones would add the clocks'
# drift against each other, some 50 µs/s.
WINDOW_NS = 60_000_000_000
# A display on this machine stamps with this machine's clock, unless the address is that of a tunnel
# to another machine. Telemetry that seems older than this, or newer than now, has another clock.
LONGEST_QUEUED_NS = 10_000_000_000
# A larger gap between two traces is a stall, or the start of another process.
BREAK_NS = 500_000_000


class StatusAge:
    """Age of the newest status of one display: the time since it was last known to be valid.

    Telemetry may queue while its reader or its display stalls. So the age counts from the display's
    time stamp, not from the receipt. A status has no stamp: it takes that of the trace before it.
    Each later trace extends its validity, up to the first gap between traces. The clock of another
    machine has an unknown offset, estimated by the shortest transit of the last one to two minutes.

    local: whether the display's address is on this machine.
    """

    def __init__(self, local: bool = False) -> None:
        self._local = local
        # Stamps of the newest trace, and of the last one at which the newest status was valid.
        self._stamped_ns: int | None = None
        self._status_ns: int | None = None
        # Smallest receipt minus stamp, in the present window and in the one before.
        self._least_ns: int | None = None
        self._before_ns: int | None = None
        self._window_ends_ns = 0
        self._received_ns: int | None = None

    def take_trace(self, stamped_ns: int, received_ns: int) -> None:
        """Take a trace whose newest tick is stamped `stamped_ns`."""
        if self._stamped_ns is not None and stamped_ns < self._stamped_ns:
            # The clock went back: the display's machine was restarted.
            self._least_ns = self._before_ns = self._status_ns = None
        elif (
            self._status_ns == self._stamped_ns is not None
            and stamped_ns - self._stamped_ns <= BREAK_NS
        ):
            self._status_ns = stamped_ns
        self._stamped_ns = stamped_ns
        difference_ns = received_ns - stamped_ns
        if received_ns >= self._window_ends_ns:
            self._window_ends_ns = received_ns + WINDOW_NS
            self._before_ns, self._least_ns = self._least_ns, difference_ns
        elif self._least_ns is None or difference_ns < self._least_ns:
            self._least_ns = difference_ns

    def take_status(self, received_ns: int) -> None:
        """Take a status."""
        self._status_ns, self._received_ns = self._stamped_ns, received_ns

    def age_ns(self, now_ns: int) -> int | None:
        """Return the age of the newest status at `now_ns` in ns; None before the first one."""
        if self._received_ns is None:
            return None
        if self._status_ns is None:
            return max(0, now_ns - self._received_ns)
        # This clock minus the display's, plus the shortest transit; 0 where they share one clock.
        known_ns = [ns for ns in (self._least_ns, self._before_ns) if ns is not None]
        offset_ns = min(known_ns, default=0)
        if self._local and 0 <= offset_ns <= LONGEST_QUEUED_NS:
            offset_ns = 0
        return max(0, now_ns - self._status_ns - offset_ns)
