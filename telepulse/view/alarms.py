"""Alarms for the person at the page, named as telemetry and recordings name them. Pure."""

import numpy as np

from display_node.telemetry.alerts import SILENT_AFTER_NS, Alert, alerts
from protocol.errors import explain_causes
from protocol.limits import limit_texts
from telepulse.telemetry.events import CUT, CUT_AFTER_NS
from telepulse.view.live import LiveState

SECOND_NS = 1_000_000_000
# What happened once is told for so long.
TOLD_NS = 5 * SECOND_NS
MUCH_LOSS = 5.0
# Columns of the statuses.
LOST, LATE, REFUSED, LIMITED = 3, 4, 6, 7


def alarms(live: LiveState, silent_ns: int) -> list[Alert]:
    """Return what is wrong now. silent_ns: for how long nothing came from the display."""
    if not live.state:
        return []
    found = alerts(live.state, live.summary, live.final, silent_ns)
    if live.final or silent_ns > SILENT_AFTER_NS:
        return found
    if live.frame_ns and not live.over and live.now_ns - live.frame_ns > CUT_AFTER_NS:
        found.append(Alert(CUT, "no frame comes from the sensing node"))
    return found + _counted(live)


def _counted(live: LiveState) -> list[Alert]:
    found = []
    recent = live.statuses.since(live.now_ns - TOLD_NS).values
    if len(recent):
        refused = int(np.ptp(recent[:, REFUSED]))
        if refused:
            causes = "; ".join(explain_causes(live.summary["rejected"]))
            found.append(Alert("refused", f"{refused} in the last 5 s; of the whole run {causes}"))
        if np.ptp(recent[:, LIMITED]) > 0:
            found.append(Alert("limited", "; ".join(limit_texts(live.summary["limited"]))))
        gone = recent[-1, LOST] + recent[-1, LATE]
        if gone > MUCH_LOSS:
            found.append(Alert("loss", f"{gone:.0f} % of the samples are lost or late"))
    if live.now_ns - live.stepped_ns < TOLD_NS:
        found.append(Alert("clock step", "a clock has jumped; it is estimated afresh"))
    if live.now_ns - live.missed_ns < TOLD_NS:
        found.append(Alert("missed", "this page is too slow for all that the display says"))
    return found
