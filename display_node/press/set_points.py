"""The finger's set-points: 50 a second, numbered, within limits, and their account. Pure."""

from typing import Final

from protocol.errors import WireError
from protocol.summary.fields import SetPointCounts
from protocol.wire.messages import ProbeReport, SetPoint

PERIOD_NS: Final = 20_000_000
# A set-point is valid until it is older than this and the round trip. A backlog that a stalled
# connection delivers at last is not.
VALID_NS: Final = 300_000_000
MOST_VALID_NS: Final = 10_000_000_000
# No probe has a greater travel, or a load cell with twice the greatest force limit.
MOST_N, MOST_M = 20.0, 0.05


class SetPointSender:
    """Sender of one display's set-points.

    Parameters
    ----------
    press
        Random number of the display's run, 0 to 2^63 − 1.
    force_limit_n, slew_limit_n_per_s
        Limits of the set-point, whatever the press.

    Attributes
    ----------
    set_point_n
        The newest set-point in N.
    sent
        Number of set-points so far.
    held_by_other
        Whether another display holds the permission to press.
    report
        The newest answer of the sensing node, if any.
    """

    def __init__(self, press: int, force_limit_n: float, slew_limit_n_per_s: float) -> None:
        self._press = press
        self._force_limit_n = force_limit_n
        self._slew_n_per_s = slew_limit_n_per_s
        self._last_ns: int | None = None
        self._session: int | None = None
        # Accounts of the sessions before.
        self._before = SetPointCounts(0, 0, 0, 0)
        self.set_point_n = 0.0
        self.sent = 0
        self.held_by_other = False
        self.report: ProbeReport | None = None

    def due(
        self, press_n: float, session: int, sensing_now_ns: int, round_trip_ns: int, now_ns: int
    ) -> SetPoint | None:
        """Return the set-point that is due by now, or None.

        Parameters
        ----------
        press_n
            The finger's press in N.
        session
            Session of the sensing node; set-points are counted anew in another one.
        sensing_now_ns, now_ns
            The present, on the sensing node's and on the display's clock.
        round_trip_ns
            Round trip of the link, by which set-points are older when they arrive.
        """
        last_ns = self._last_ns
        if last_ns is not None and 0 <= now_ns - last_ns < PERIOD_NS:
            return None
        if session != self._session:
            self._restart(session)
        if last_ns is not None and now_ns - last_ns > VALID_NS:
            # The wrist has eased off meanwhile.
            self.set_point_n = 0.0
        # After a pause, the set-point moves no further than between two ordinary ones. The next
        # one is due a whole number of periods after this one's due time, not after its sending.
        late_ns = 0 if last_ns is None else (now_ns - last_ns) % PERIOD_NS
        self._last_ns = now_ns - late_ns
        most_n = self._slew_n_per_s * PERIOD_NS * 1e-9
        wanted_n = min(press_n, self._force_limit_n) if press_n > 0 else 0.0
        change_n = min(max(wanted_n - self.set_point_n, -most_n), most_n)
        self.set_point_n += change_n
        number, self.sent = self.sent, self.sent + 1
        valid_ns = min(VALID_NS + max(0, round_trip_ns), MOST_VALID_NS)
        return SetPoint(session, self._press, number, sensing_now_ns, valid_ns, self.set_point_n)

    def take(self, report: ProbeReport) -> bool:
        """Take an answer of the sensing node; return whether it is a newer one to this display.

        Raises WireError, with the cause "false_report", for one that cannot be true.
        """
        if report.press != self._press or report.session != self._session:
            return False
        self.held_by_other = report.state == "held"
        known = self.report
        arrived = report.applied + report.superseded
        counted = (
            f"{report.received} set-points, {arrived} of them taken, and {self.sent} were sent"
        )
        measured = f"{report.hold_down_n:.3g} N at {report.depth_m:.3g} m"
        if report.received > self.sent or arrived > report.received:
            raise WireError("false_report", f"the probe reports {counted}")
        if abs(report.hold_down_n) > MOST_N or abs(report.depth_m) > MOST_M:
            raise WireError("false_report", f"the probe reports {measured}")
        if self.held_by_other:
            return False
        if known is not None and arrived <= known.applied + known.superseded:
            return False
        self.report = report
        return True

    def counts(self) -> SetPointCounts:
        """Return the account over all sessions; those under way count as lost until answered."""
        before, report = self._before, self.report
        applied = 0 if report is None else report.applied
        superseded = 0 if report is None else report.superseded
        present = self.sent, applied, superseded, self.sent - applied - superseded
        earlier = before.sent, before.applied, before.superseded, before.lost
        return SetPointCounts(*((a or 0) + b for a, b in zip(earlier, present, strict=True)))

    def _restart(self, session: int) -> None:
        """Begin another session of the sensing node, whose probe is off the wrist."""
        self._before = self.counts()
        self._session = session
        self.set_point_n, self.sent, self.report, self.held_by_other = 0.0, 0, None, False
