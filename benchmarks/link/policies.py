"""Policies for late samples over TCP, on drawn and recorded pulses.

fresh
    At time t the pulse of t − E is played. Samples that have not arrived are predicted from the
    newest one that has.
classic buffer
    A jitter buffer delivers every sample one fixed delay after it was taken, and discards the 1 %
    that come later. If E is shorter than this delay, the rest is predicted from delivered samples.
hold
    As fresh, but the newest value is held instead of predicting.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.prediction import Predictor, PredictorName, build_predictors
from telepulse.simulation.link_model import MessageLink
from telepulse.simulation.link_scene import parse_link
from tests.support.drawn_pulses import RATE_HZ, SCORED_FROM_S, Pulse

DELAYS_MS = (0, 40, 80)
FRAME = 5
# A frame of five samples takes about this many bytes on the wire.
FRAME_BYTES = 60
LATE_TARGET = 0.01
TICK_NS = 1_000_000_000 // RATE_HZ
FRESH, CLASSIC, HOLD = "fresh", "classic buffer", "hold"

Nrmse = tuple[float, ...]


class PolicyErrors(NamedTuple):
    """NRMSE of each late-sample policy at each of `DELAYS_MS`; the classic buffer's delay."""

    errors: dict[str, Nrmse]
    classic_delay_ms: int


def run_policies(pulse: Pulse, link: str, seed: int = 1) -> PolicyErrors:
    """Play a pulse over a link by each policy; scored as in the benchmark of prediction."""
    arrived = arrivals_ms(len(pulse.sensed) // FRAME, link, seed)
    taken = np.arange(len(arrived)) * FRAME + FRAME - 1
    classic_ms = round(float(np.quantile(arrived - taken, 1 - LATE_TARGET, method="higher")))
    delivered = [
        sent + classic_ms if arrival - sent <= classic_ms else None
        for sent, arrival in zip(taken.tolist(), arrived.tolist(), strict=True)
    ]
    policies: dict[str, tuple[Sequence[int | None], PredictorName]] = {
        FRESH: (arrived.tolist(), "stack"),
        CLASSIC: (delivered, "stack"),
        HOLD: (arrived.tolist(), "hold"),
    }
    errors = {
        name: _policy_nrmse(pulse, known_at, build_predictors(predictor)[0])
        for name, (known_at, predictor) in policies.items()
    }
    return PolicyErrors(errors, classic_ms)


def arrivals_ms(frames: int, link: str, seed: int) -> NDArray[np.int64]:
    """Return the tick at which each frame can be read, over a link that loses none."""
    model = MessageLink(parse_link(link), seed)
    arrived_ns = []
    for frame in range(frames):
        arrival_ns = model.data_arrival_ns((frame * FRAME + FRAME - 1) * TICK_NS, FRAME_BYTES)
        if arrival_ns is None:
            raise ValueError(f"{link}: the link loses frames, which then have no delay")
        arrived_ns.append(arrival_ns)
    return -(-np.array(arrived_ns) // TICK_NS)


def _policy_nrmse(pulse: Pulse, known_at: Sequence[int | None], predictor: Predictor) -> Nrmse:
    """Return the NRMSE at each delay; frame i is known from tick known_at[i] on, or never."""
    scored_from, ticks = round(SCORED_FROM_S * RATE_HZ), len(known_at) * FRAME
    frames = [(at, frame) for frame, at in enumerate(known_at) if at is not None]
    known = np.zeros(ticks, dtype=bool)
    squares, newest, coming = np.zeros(len(DELAYS_MS)), -1, 0
    for now in range(ticks):
        while coming < len(frames) and frames[coming][0] <= now:
            first = frames[coming][1] * FRAME
            newest, coming = first + FRAME - 1, coming + 1
            known[first : newest + 1] = True
            times_ns = [sample * TICK_NS for sample in range(first, newest + 1)]
            predictor.observe(times_ns, pulse.sensed[first : newest + 1].tolist())
        while predictor.work():
            pass
        if now < scored_from:
            continue
        for row, delay_ms in enumerate(DELAYS_MS):
            instant = now - delay_ms
            value = (
                float(pulse.sensed[instant])
                if known[instant]
                else predictor.predict(max(instant, newest) * TICK_NS)
            )
            squares[row] += (value - pulse.true[instant]) ** 2
    return tuple(np.sqrt(squares / (ticks - scored_from)).tolist())
