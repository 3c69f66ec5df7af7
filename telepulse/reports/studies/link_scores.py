"""Scores of links: each link at each perceived delay with each predictor; late-sample policies.

The perceived delay E is the part of a link's delay that is buffered; the rest is predicted. Each
case runs both nodes in virtual time. Three policies for late samples are compared over TCP:

fresh
    At time t the pulse of t − E is played. Samples that have not arrived are predicted from the
    newest one that has.
classic buffer
    A jitter buffer delivers every sample one fixed delay after it was taken, and discards the 1 %
    that come later. If E is shorter than this delay, the rest is predicted from delivered samples.
hold
    As fresh, but the newest value is held instead of predicting.
"""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.prediction import Predictor, PredictorName, build_predictors
from display_node.prediction.scene import own_predictor
from display_node.scoring.tracking_error import JND
from protocol.config.scene_file import find_scene
from protocol.tactile import matching_force_ratio
from protocol.ticks import TickState
from sensing_node.scene import build_source, describe_stream
from telepulse.parallel import in_one_thread, sweep
from telepulse.reports.studies.prediction_pulses import RATE_HZ, SCORED_FROM_S, Pulse, pulses
from telepulse.scene import load_scene
from telepulse.simulation.link_model import MessageLink
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation

PREDICTORS: tuple[PredictorName, ...] = ("hold", "linear", "stack")
# Late-sample policies.
DELAYS_MS = (0, 40, 80)
FRAME = 5
# A frame of five samples takes about this many bytes on the wire.
FRAME_BYTES = 60
LATE_TARGET = 0.01
TICK_NS = 1_000_000_000 // RATE_HZ
FRESH, CLASSIC, HOLD = "fresh", "classic buffer", "hold"
# Figures of a prototype, at each of the delays.
PROTOTYPE = {
    FRESH: (0.108, 0.043, 0.039),
    CLASSIC: (0.264, 0.251, 0.229),
    HOLD: (0.770, 0.310, 0.261),
}

Nrmse = tuple[float, ...]


class LinkSpec(NamedTuple):
    """A link as `parse_link` reads it, and the perceived delays in ms to run on it."""

    text: str
    delays_ms: tuple[float, ...]


LAN, NEAR, FAR = "LAN", "20 ± 3 ms, 1 % lost", "40 ± 10 ms"
BURSTS, TCP = "20 ms with bursts", "TCP, 40 ms, 1 % lost"
LINKS: dict[str, LinkSpec] = {
    LAN: LinkSpec("delay=0.5ms,jitter=0.2ms", (0, 4, 8, 12)),
    NEAR: LinkSpec("delay=20ms,jitter=3ms,loss=1%", (0, 10, 20, 30, 40)),
    FAR: LinkSpec("delay=40ms,jitter=10ms", (0, 20, 40, 60, 80)),
    BURSTS: LinkSpec("delay=20ms,jitter=10ms,jitter_kind=bursts", (0, 20, 40, 80, 120)),
    TCP: LinkSpec("delay=40ms,jitter=3ms,loss=1%,transport=tcp", (0, 40, 80, 120, 160)),
}


@dataclass(frozen=True, slots=True)
class LinkEffort:
    """Simulated links; `settle_seconds` in which predictors learn, then scored `seconds`."""

    seconds: float = 15.0
    settle_seconds: float = 20.0
    seeds: tuple[int, ...] = (1, 2)
    links: tuple[str, ...] = tuple(LINKS)


class LinkCase(NamedTuple):
    """A link as `parse_link` reads it, a predictor, a perceived delay E and a seed.

    delay_ms is None where the display chooses E. The seed is the link's and the pulse's.
    """

    link: str
    predictor: PredictorName
    delay_ms: float | None
    seed: int = 1

    def __str__(self) -> str:
        delay = "auto" if self.delay_ms is None else f"{self.delay_ms:g} ms"
        return f"{self.predictor} at E = {delay} over {self.link}, seed {self.seed}"


class LinkResult(NamedTuple):
    """Errors and delays of a case.

    Attributes
    ----------
    in_phase_n, aligned_n
        RMS difference in N from the present pulse, and from the pulse E before.
    deviation_n, peak_to_peak_n
        Standard deviation and height of the pulse itself, scaled as felt, in N.
    delay_ms
        Mean perceived delay E, which is buffered.
    horizon_ms, longest_ms
        Mean and largest age of the newest sample over the played instant, which is predicted.
    predicted
        Share of the ticks without a sample.
    felt
        Share of the time in which the pulse was felt; in the rest missing samples had faded it out.
    roughness
        Energy of the felt force above 25 Hz over the pulse's.
    lost
        Share of the samples that were lost.
    """

    in_phase_n: float
    aligned_n: float
    deviation_n: float
    peak_to_peak_n: float
    delay_ms: float
    horizon_ms: float
    longest_ms: float
    predicted: float
    felt: float
    roughness: float
    lost: float

    @property
    def in_phase(self) -> float:
        """NRMSE against the present pulse."""
        return self.in_phase_n / self.deviation_n

    @property
    def aligned(self) -> float:
        """NRMSE against the pulse E before."""
        return self.aligned_n / self.deviation_n

    @property
    def in_phase_jnd(self) -> float:
        """Error in phase over the just noticeable difference in force."""
        return self.in_phase_n / (JND * self.peak_to_peak_n)


# By perceived delay; None: chosen by the display.
Curve = dict[float | None, LinkResult]


class PolicyErrors(NamedTuple):
    """NRMSE of each late-sample policy at each of `DELAYS_MS`; the classic buffer's delay."""

    errors: dict[str, Nrmse]
    classic_delay_ms: int


class LinkScores(NamedTuple):
    """Results by link and predictor, policies by pulse, and costs by predictor.

    A cost is the processor time in µs of a simulated millisecond, both nodes and the link.
    """

    results: dict[str, dict[PredictorName, Curve]]
    policies: dict[str, PolicyErrors]
    costs_us: dict[PredictorName, float]


def score_links(effort: LinkEffort, scheduler: str | None = None) -> LinkScores:
    """Run every case on all cores or a Dask cluster, then measure the costs here.

    Raises SweepError or SourceError.
    """
    grid = [
        (name, predictor, delay_ms)
        for name in effort.links
        for predictor in PREDICTORS
        for delay_ms in (*LINKS[name].delays_ms, None)
    ]
    cases = [
        LinkCase(LINKS[name].text, predictor, delay_ms, seed)
        for name, predictor, delay_ms in grid
        for seed in effort.seeds
    ]
    ran = iter(sweep(partial(run_link, effort=effort), cases, scheduler))
    results: dict[str, dict[PredictorName, Curve]] = {
        name: {predictor: {} for predictor in PREDICTORS} for name in effort.links
    }
    for name, predictor, delay_ms in grid:
        results[name][predictor][delay_ms] = pooled([next(ran) for _ in effort.seeds])
    # The prototype used an arterial recording, which is not available; heartpy's first replaces it.
    sets = [each for each in pulses(60.0, seed=1) if each.name in ("variability", "heartpy data")]
    policies = sweep(partial(run_policies, link=LINKS[TCP].text), sets, scheduler)
    return LinkScores(
        results,
        {pulse.name: each for pulse, each in zip(sets, policies, strict=True)},
        # Measured after all other cases have ended, so that nothing else runs.
        in_one_thread(costs_us, effort),
    )


def costs_us(effort: LinkEffort) -> dict[PredictorName, float]:
    """Return the least processor time of a simulated millisecond in two rounds, all predicted.

    The predictors take turns, so that a busy moment of the machine affects all alike.
    """
    least_us: dict[PredictorName, float] = dict.fromkeys(PREDICTORS, math.inf)
    for predictor in PREDICTORS * 2:
        began_s = time.process_time()
        run_link(LinkCase(LINKS[FAR].text, predictor, 0.0), effort)
        taken_s = time.process_time() - began_s
        cost_us = taken_s / (effort.settle_seconds + effort.seconds) * 1e3
        least_us[predictor] = min(least_us[predictor], cost_us)
    return least_us


def run_link(case: LinkCase, effort: LinkEffort) -> LinkResult:
    """Simulate a case. Raises SceneError."""
    scene = load_scene(find_scene("radial"))
    source = scene.sensing.source.model_copy(update={"seed": case.seed})
    delay_ns = None if case.delay_ms is None else round(case.delay_ms * 1e6)
    display = {"predictor": own_predictor(case.predictor), "compensation_ns": delay_ns}
    scene = replace(
        scene,
        sensing=scene.sensing.model_copy(update={"source": source}),
        display=scene.display.model_copy(update=display),
        link=parse_link(case.link),
    )
    simulation = Simulation(scene, case.seed)
    delays_ns, horizons_ns = [], []

    def watch(tick: TickState) -> None:
        newest_ns = simulation.newest_ns
        if newest_ns is not None:
            delays_ns.append(tick.playout_delay_ns)
            horizons_ns.append(max(0, tick.instant_ns - newest_ns))

    summary = simulation.run(effort.settle_seconds + effort.seconds, effort.settle_seconds, watch)
    samples, errors, horizon_ns = summary.samples, summary.force_rmse_n, np.array(horizons_ns)
    # The force that should be felt in the scored time.
    sensed = build_source(scene.sensing, scene.path.parent)
    channel = describe_stream(scene.sensing, sensed).find(scene.display.channel)
    rate_hz = 1e9 / sensed.period_ns
    sensed.take(round(effort.settle_seconds * rate_hz))
    wrist_n = sensed.take(round(effort.seconds * rate_hz))[:, channel]
    pulse_n = wrist_n * matching_force_ratio(
        scene.sensing.layer.layer(), scene.display.layer.layer()
    )
    return LinkResult(
        in_phase_n=errors.in_phase or math.nan,
        aligned_n=errors.aligned or math.nan,
        deviation_n=float(pulse_n.std()),
        peak_to_peak_n=float(np.ptp(pulse_n)),
        delay_ms=float(np.mean(delays_ns)) * 1e-6,
        horizon_ms=float(horizon_ns.mean()) * 1e-6,
        longest_ms=float(horizon_ns.max()) * 1e-6,
        predicted=float(np.mean(horizon_ns > 0)),
        felt=len(delays_ns) * scene.display.tick_ns * 1e-9 / effort.seconds,
        roughness=summary.roughness.energy_ratio or math.nan,
        lost=(samples.lost or 0) / (samples.sent or 1),
    )


def pooled(results: Sequence[LinkResult]) -> LinkResult:
    """Pool the results of several seeds: forces by root mean square, the rest by the mean."""
    values = {}
    for name in LinkResult._fields:
        column = np.array([getattr(result, name) for result in results])
        is_force = name.endswith("_n")
        values[name] = float(np.sqrt(np.mean(column**2)) if is_force else column.mean())
    return LinkResult(**values)._replace(longest_ms=max(one.longest_ms for one in results))


def run_policies(pulse: Pulse, link: str, seed: int = 1) -> PolicyErrors:
    """Play a pulse over a link by each policy; scored as in `telepulse study prediction`."""
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
