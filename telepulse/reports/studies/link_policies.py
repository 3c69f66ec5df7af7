"""Three ways to treat late samples over TCP: predict from the newest, throw them away, hold.

fresh: at time t the pulse of t − E is played; what has not arrived is predicted from the newest
sample that has. classic: a jitter buffer hands over every sample one fixed delay after it was
taken, with 1 % of them late and thrown away; what E asks for before that is predicted from what
was handed over. hold: as fresh, but the newest value stays.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from display_node.prediction import Predictor, build_predictor
from telepulse.reports.studies.prediction_sets import RATE_HZ, SCORED_FROM_S, Pulse
from telepulse.simulation.link_model import MessageLink, parse_link

DELAYS_MS = (0, 40, 80)
FRAME = 5
# What a frame of five samples takes on the wire, about.
FRAME_BYTES = 60
LATE_TARGET = 0.01
TICK_NS = 1_000_000_000 // RATE_HZ
FRESH, CLASSIC, HOLD = "fresh", "classic buffer", "hold"
# What the project's issue on the link quotes of a prototype, at each of the delays.
PROTOTYPE = {
    FRESH: (0.108, 0.043, 0.039),
    CLASSIC: (0.264, 0.251, 0.229),
    HOLD: (0.770, 0.310, 0.261),
}

Nrmse = tuple[float, ...]
Milliseconds = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Policies:
    """NRMSE of each policy at each of `DELAYS_MS`; the classic buffer's delay."""

    errors: dict[str, Nrmse]
    classic_delay_ms: int


def play_policies(pulse: Pulse, link: str, seed: int = 1) -> Policies:
    """Play a pulse over a link in each way; scored as in `telepulse study prediction`."""
    arrived = arrivals_ms(len(pulse.sensed) // FRAME, link, seed)
    taken = np.arange(len(arrived)) * FRAME + FRAME - 1
    classic_ms = round(float(np.quantile(arrived - taken, 1 - LATE_TARGET, method="higher")))
    handed_over = [
        sent + classic_ms if arrival - sent <= classic_ms else None
        for sent, arrival in zip(taken.tolist(), arrived.tolist(), strict=True)
    ]
    return Policies(
        {
            FRESH: _play(pulse, arrived.tolist(), build_predictor("stack", TICK_NS)),
            CLASSIC: _play(pulse, handed_over, build_predictor("stack", TICK_NS)),
            HOLD: _play(pulse, arrived.tolist(), build_predictor("hold", TICK_NS)),
        },
        classic_ms,
    )


def arrivals_ms(frames: int, link: str, seed: int) -> Milliseconds:
    """The tick at which each frame can be read; one that none was lost over."""
    way = MessageLink(parse_link(link), seed)
    arrived_ns = []
    for frame in range(frames):
        arrival_ns = way.data_arrival_ns((frame * FRAME + FRAME - 1) * TICK_NS, FRAME_BYTES)
        if arrival_ns is None:
            raise ValueError(f"{link}: frames are lost, so that there is no delay of theirs")
        arrived_ns.append(arrival_ns)
    return np.array([-(-arrival_ns // TICK_NS) for arrival_ns in arrived_ns])


def _play(pulse: Pulse, known_at: Sequence[int | None], predictor: Predictor) -> Nrmse:
    """NRMSE at each delay when frame i is known from tick known_at[i] on, in order; or never."""
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
        predictor.work()
        if now < scored_from:
            continue
        for row, delay_ms in enumerate(DELAYS_MS):
            instant = now - delay_ms
            played = (
                float(pulse.sensed[instant])
                if known[instant]
                else predictor.predict(max(instant, newest) * TICK_NS)
            )
            squares[row] += (played - pulse.true[instant]) ** 2
    return tuple(np.sqrt(squares / (ticks - scored_from)).tolist())
