"""Age of a display's newest status, by the time stamps of its telemetry. Pure."""

# Of how long ago the shortest transit is used: two clocks drift by some 50 µs/s against each other.
WINDOW_NS = 60_000_000_000
# A display on this machine stamps by this machine's clock, unless the address leads through a
# tunnel. Telemetry that seems to be older than this, or of the future, has another clock.
LONGEST_QUEUED_NS = 10_000_000_000
# Traces further apart have a stall between them, or the start of another process.
BREAK_NS = 500_000_000


class TelemetryAge:
    """Age of the newest status of one display, as of the last time when it held.

    Telemetry may have queued while its reader or its display stood still, so its age counts from
    the display's stamp and not from its receipt. A status has no stamp: it follows a trace of the
    same tick, and holds until the newest of the traces that follow without a break. The clock of
    another machine has an unknown offset: there, the age counts from the earliest receipt that the
    shortest transit of the last one to two minutes allows. local: the address is on this machine.
    """

    def __init__(self, local: bool = False) -> None:
        self._local = local
        # The newest trace, and the one until which the newest status holds.
        self._stamped_ns: int | None = None
        self._status_ns: int | None = None
        # Least difference of receipt and stamp, in the present window and in the one before.
        self._least_ns: int | None = None
        self._before_ns: int | None = None
        self._window_ends_ns = 0
        self._received_ns: int | None = None

    def take_trace(self, stamped_ns: int, received_ns: int) -> None:
        """Take a trace whose newest tick is stamped `stamped_ns`."""
        if self._stamped_ns is not None and stamped_ns < self._stamped_ns:
            # Another clock: its machine was started again.
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
        # This clock less the display's, with the shortest transit where it is another.
        known = [least for least in (self._least_ns, self._before_ns) if least is not None]
        offset_ns = min(known, default=0)
        if self._local and 0 <= offset_ns <= LONGEST_QUEUED_NS:
            offset_ns = 0
        return max(0, now_ns - self._status_ns - offset_ns)
