"""What a person must be told of, named as telemetry and recordings name it. Pure."""

from typing import NamedTuple

import numpy as np

from display_node.deadlines import deadline_alarm
from protocol.limits import limit_texts
from telepulse.view.live import Live

SECOND_NS = 1_000_000_000
# As long as a display waits before it takes a sensing node for silent.
CUT_AFTER_NS = SECOND_NS
SILENT_AFTER_NS = 2 * SECOND_NS
# What happened once is told for so long.
TOLD_NS = 5 * SECOND_NS
MUCH_LOSS = 5.0
# Columns of the statuses.
LOST, LATE, REFUSED, LIMITED = 3, 4, 6, 7


class Alarm(NamedTuple):
    """name stays the same as long as it lasts; text may count."""

    name: str
    text: str


def alarms(live: Live, silent_ns: int) -> list[Alarm]:
    """What is wrong now. silent_ns: for how long nothing came from the display."""
    found = [Alarm(f"fault: {fault}", "latched") for fault in live.summary.get("faults", [])]
    if live.final or not live.state:
        return found
    if silent_ns > SILENT_AFTER_NS:
        return [*found, Alarm("no telemetry", "the display says nothing")]
    if live.frame_ns and not live.over and live.now_ns - live.frame_ns > CUT_AFTER_NS:
        found.append(Alarm("link cut", "no frame comes from the sensing node"))
    if live.state == "stale":
        found.append(Alarm("stale", "no samples to play; the finger is at rest"))
    return found + _counted(live)


def _counted(live: Live) -> list[Alarm]:
    found = []
    late = deadline_alarm(live.summary["loop"])
    if late is not None:
        found.append(Alarm("deadline misses", late))
    recent = live.statuses.since(live.now_ns - TOLD_NS).values
    if len(recent):
        refused = int(np.ptp(recent[:, REFUSED]))
        if refused:
            causes = ", ".join(sorted(live.summary["rejected"]))
            found.append(Alarm("refused", f"{refused} messages in the last 5 s ({causes})"))
        if np.ptp(recent[:, LIMITED]) > 0:
            found.append(Alarm("limited", "; ".join(limit_texts(live.summary["limited"]))))
        gone = recent[-1, LOST] + recent[-1, LATE]
        if gone > MUCH_LOSS:
            found.append(Alarm("loss", f"{gone:.0f} % of the samples are lost or late"))
    if live.now_ns - live.stepped_ns < TOLD_NS:
        found.append(Alarm("clock step", "a clock has jumped; it is estimated afresh"))
    if live.now_ns - live.missed_ns < TOLD_NS:
        found.append(Alarm("missed", "this page is too slow for all that the display says"))
    return found
