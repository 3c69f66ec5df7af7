"""A sweep of a modelled wrist in virtual time: probe, set-points and samples, without a link."""

from typing import Final

from display_node.press.set_points import SetPointSender
from display_node.press.sweep import DepthSweep
from protocol.errors import SceneError
from protocol.wire.messages import channel_samples
from sensing_node.press.set_points import SetPointServer
from sensing_node.sources.source import SampleSource

SESSION, PRESS = 7, 11
BATCH: Final = 5
# Slew of the set-points; the probe limits its own as well.
SLEW_N_PER_S: Final = 20.0


def sweep_wrist(wrist: SampleSource, sweep: DepthSweep, most_n: float) -> int:
    """Sweep a wrist until the sweep is over; return the number of samples that it took.

    most_n: limit of the set-points. Raises SceneError for a source that no probe presses.
    """
    if (probe := wrist.pressed) is None:
        raise SceneError("[sensing] source: no probe presses it, so that it cannot be swept")
    server = SetPointServer(SESSION, probe)
    sender = SetPointSender(PRESS, most_n, SLEW_N_PER_S)
    period_ns, taken = wrist.period_ns, 0
    while not sweep.over:
        film, cell = wrist.take(BATCH).T.tolist()
        pulse = channel_samples(taken, taken * period_ns, period_ns, film)
        taken += BATCH
        now_ns = taken * period_ns
        sweep.observe(pulse, [total - part for total, part in zip(cell, film, strict=True)])
        sweep.tick(now_ns, probe.state)
        set_point = sender.due(sweep.press_n, SESSION, now_ns, 0, now_ns)
        if set_point is not None:
            sender.take(server.answer(set_point, now_ns))
    return taken
