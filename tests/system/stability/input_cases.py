"""Hard inputs: spikes, denormals and NaN in reference, reading and samples; extreme models."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from display_node.display import Display
from display_node.plant.filters import LowPass
from display_node.plant.second_order import SecondOrder
from display_node.plant.stepper import Rotor
from display_node.scene import DisplayScene
from protocol.tactile import ElasticLayer, matching_force_ratio
from protocol.wire.messages import (
    ClockReply,
    ClockRequest,
    Frame,
    Hello,
    Welcome,
    encode_control,
    encode_frame,
)
from protocol.wire.stream import Channel, StreamDescription
from telepulse.paper import published
from telepulse.paper.stability import HELD_N, SAFETY
from tests.system.stability.hard_case import (
    CaseResult,
    CaseVerdict,
    HardCase,
    common_setups,
    evaluate,
    make_setup,
)

STRANGE_AT = 500
MS = 1_000_000
SESSION = 1
BATCH = 5
STREAM_FROM_MS, STREAM_TO_MS = 500, 2000
LONG_S = 0.1
SHORT_TICK_COUNT = 100_000
EXACT = 1e-9


def strange_samples() -> Iterator[CaseResult]:
    """Put one sample that is not a usable force into the reference, and into the film's reading.

    Samples with the same verdict and reason share a row.
    """
    pid = make_setup({"kp": 0.1, "kd": 1e-4}, {"kind": "stepper"})
    setups = {**common_setups(), "PID on force with kd": pid}
    samples_n = {
        "a force spike": {"100": 100.0, "−100": -100.0, "1e+30": 1e30, "−1e+30": -1e30},
        "denormals and NaN": {"5e-324": 5e-324, "NaN": math.nan, "∞": math.inf, "−∞": -math.inf},
    }
    places = {
        "reference": "Safety bounds force and slew of the reference",
        "reading": "the drive's limits bound the effect of one reading",
    }
    rows = product(samples_n.items(), setups.items(), places.items())
    for (case, strange_n), (name, setup), (place, explanation) in rows:
        alike: dict[tuple[CaseVerdict, str], list[str]] = {}
        for text, value_n in strange_n.items():
            hard = HardCase(case, "", setup, explanation, ticks=1000, disturbance_tick=STRANGE_AT)
            strange: dict[str, Any] = {place: _strange_at(value_n)}
            result = evaluate(replace(hard, **strange))
            alike.setdefault((result.verdict, result.reason), []).append(text)
        for (verdict, reason), texts in alike.items():
            what = f"{name}, one {place} of {', '.join(texts)} N"
            yield CaseResult(case, what, verdict, reason)


def _strange_at(strange_n: float) -> Callable[..., float]:
    return lambda tick, usual_n=HELD_N: strange_n if tick == STRANGE_AT else usual_n


def peer_frames() -> Iterator[CaseResult]:
    """Send a display strange values in every other frame, and descriptions of extreme layers."""
    for strange_n, text in (
        (math.nan, "NaN"),
        (math.inf, "∞"),
        (-math.inf, "−∞"),
        (5e-324, "5e-324 N"),
        (1e308, "1e308 N"),
        (-1e308, "−1e308 N"),
    ):
        yield _streamed(f"every other frame of a peer holds {text}", strange_n, published.LAYER)
    for modulus_pa in (1e-300, 1e-303):
        name = f"a peer's layer has E = {modulus_pa:g} Pa"
        try:
            layer = ElasticLayer(young_modulus_pa=modulus_pa)
        except ValueError as error:
            # The display decodes a peer's description with this same class.
            yield CaseResult("a peer's samples", name, CaseVerdict.REFUSED, str(error))
        else:
            yield _streamed(name, HELD_N, layer)


def _streamed(name: str, strange_n: float, layer: ElasticLayer) -> CaseResult:
    """Feed a display for some seconds, and judge its felt force and its counts."""
    scene = DisplayScene.model_validate(
        {
            "controller": {"kp": 300, "error": "position", "feed_forward": True},
            "actuator": {"kind": "stepper"},
            "compensation": "20 ms",
        }
    )
    display = Display(scene, "hard cases", score=False)
    stream = StreamDescription("hard cases", MS, BATCH, (Channel("pulse"),), layer, 8)
    felt_n, frames, strange_frames = [], 0, 0
    for tick in range(STREAM_TO_MS):
        now_ns = tick * MS
        felt_n.append(display.tick(now_ns).felt_n)
        # A sensing node's answers, on the display's own clock.
        for request in display.requests(now_ns):
            match request:
                case Hello():
                    display.on_control(encode_control(Welcome(SESSION, 0, stream)), now_ns)
                case ClockRequest(t1_ns=t1_ns):
                    reply = ClockReply(SESSION, t1_ns, now_ns, now_ns)
                    display.on_control(encode_control(reply), now_ns)
        if tick >= STREAM_FROM_MS and tick % BATCH == 0:
            strange = frames % 2 == 1
            values = np.full((BATCH, 1), strange_n if strange else HELD_N)
            frame = Frame(SESSION, frames * BATCH, now_ns - (BATCH - 1) * MS, MS, values)
            display.on_frame(encode_frame(frame), now_ns)
            frames, strange_frames = frames + 1, strange_frames + strange
    refused = display.receiver.rejected["not_finite"]
    ratio, limit_n = display.contactors[0].force_ratio, SAFETY.force_limit_n
    verdict, reason = CaseVerdict.STABLE, "Safety bounds force and slew of the buffer's output"
    if not (0 < ratio < math.inf and np.isfinite(felt_n).all()):
        verdict = CaseVerdict.WRONG
        reason = f"accepts a force ratio of {ratio:g}".replace("inf", "∞")
    elif max(felt_n) > limit_n:
        verdict, reason = CaseVerdict.WRONG, f"felt beyond the limit of {limit_n:g} N"
    elif refused == strange_frames:
        verdict = CaseVerdict.REFUSED
        reason = "a frame with a sample that is not finite is counted, not played"
    elif ratio * HELD_N > limit_n:
        reason = f"force ratio {ratio:.3g}; Safety holds the limit of {limit_n:g} N"
    return CaseResult("a peer's samples", name, verdict, reason)


def layers() -> Iterator[CaseResult]:
    """Strain extreme layers by 1 N and back, and compare them with Table 3's layer."""
    for name, key, symbol, unit, values in (
        ("ν → 0.5", "poisson_ratio", "ν", "", (0.0, 0.4999999, 0.5, 0.5000001)),
        ("vanishing thickness", "thickness_m", "d", " m", (1e-12, 1e-300, 5e-324, 0.0)),
        ("vanishing modulus", "young_modulus_pa", "E", " Pa", (1e-300, 1e-303)),
    ):
        for value in values:
            what = f"{symbol} = {value!r}{unit}, against Table 3"
            try:
                layer = ElasticLayer(**{key: value})
            except ValueError as error:
                yield CaseResult(name, what, CaseVerdict.REFUSED, str(error))
                continue
            strain, paper = layer.strain(1.0), published.LAYER
            ratios = matching_force_ratio(paper, layer), matching_force_ratio(layer, paper)
            off = abs(layer.force(strain) - 1)
            verdict = CaseVerdict.STABLE
            reason = f"finite; force → strain → force differs by {off:.1g}"
            if not np.isfinite([strain, *ratios]).all() or 0 in ratios or off > EXACT:
                verdict = CaseVerdict.WRONG
                reason = "a force ratio that is no usable number is not refused"
            yield CaseResult(name, what, verdict, reason)


def exact_steps() -> Iterator[CaseResult]:
    """Step each model over 100 ms: in one tick, and in ticks of 1 µs."""

    def held(ticks: int) -> float:
        model = SecondOrder(published.ACTUATOR, LONG_S / ticks)
        for _ in range(ticks):
            model.step(1.0)
        return model.force_n

    def turned(damping: float, ticks: int) -> float:
        model = Rotor(100.0, damping, LONG_S / ticks)
        for tick in range(ticks):
            model.step(tick / ticks, (tick + 1) / ticks)
        return model.position_m

    def filtered(order: int, ticks: int) -> float:
        model = LowPass(40.0, order, LONG_S / ticks)
        for tick in range(ticks):
            model.advance(tick / ticks)
        return model.output(1.0)

    models: dict[str, Callable[[int], float]] = {
        "eq 22 under a held voltage": held,
        "rotor at 100 Hz, ζ = 0.2, on a ramp": lambda ticks: turned(0.2, ticks),
        "rotor at 100 Hz, ζ = 0, on a ramp": lambda ticks: turned(0.0, ticks),
        "low-pass of 40 Hz, 1 pole, on a ramp": lambda ticks: filtered(1, ticks),
        "low-pass of 40 Hz, 4 poles, on a ramp": lambda ticks: filtered(4, ticks),
    }
    for name, model in models.items():
        off = abs(model(SHORT_TICK_COUNT) / model(1) - 1)
        run = f"{name}, one tick of 100 ms and {SHORT_TICK_COUNT} of 1 µs"
        verdict, reason = CaseVerdict.STABLE, "exact at any tick"
        if not off < EXACT:
            verdict, reason = CaseVerdict.WRONG, f"the two are {off:.1g} apart"
        yield CaseResult("extreme ticks", run, verdict, reason)


def all_cases() -> Iterator[CaseResult]:
    """Run and judge every case of inputs and models."""
    yield from layers()
    yield from exact_steps()
    yield from strange_samples()
    yield from peer_frames()
