"""Hard inputs: spikes, denormals and NaN in reference, reading and samples; extreme models."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

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
from telepulse.reports.paper import published
from telepulse.reports.paper.hard_case import (
    HELD_N,
    SAFETY,
    Array,
    CaseResult,
    CaseRun,
    CaseVerdict,
    HardCase,
    LoopSetup,
    common_setups,
    evaluate,
    force_text,
    make_setup,
)

ODD_AT = 500
TICKS = 1000
SPIKES_N = (100.0, -100.0, 1e30, -1e30)
NOT_FORCES_N = (5e-324, math.nan, math.inf, -math.inf)
MS = 1_000_000
SESSION = 1
BATCH = 5
STREAM_FROM_MS, STREAM_TO_MS = 500, 2000
LONG_S = 0.1
SHORT_TICKS = 100_000
EXACT = 1e-9
UNDAMPED_HZ = 100.0
FILTER_HZ = 40.0


def spikes() -> Iterator[CaseResult]:
    """Put one sample of a far too large force into the reference, and into the film's reading."""
    yield from _odd_samples("a force spike", SPIKES_N)


def not_forces() -> Iterator[CaseResult]:
    """Put one denormal, NaN or infinite sample into the reference, and into the reading."""
    yield from _odd_samples("denormals and NaN", NOT_FORCES_N)


def _odd_samples(case: str, odd_n: tuple[float, ...]) -> Iterator[CaseResult]:
    """Yield one row for all samples with the same verdict and reason."""
    pid = make_setup({"kp": 0.1, "kd": 1e-4}, {"kind": "stepper"})
    for name, setup in {**common_setups(), "PID on force with kd": pid}.items():
        for place in ("reference", "reading"):
            alike: dict[tuple[CaseVerdict, str], list[str]] = {}
            felt_n: dict[tuple[CaseVerdict, str], list[Array]] = {}
            for value_n in odd_n:
                result, run = _run_odd(case, setup, place, value_n)
                key = result.verdict, result.reason
                alike.setdefault(key, []).append(_number_text(value_n))
                felt_n.setdefault(key, []).extend(run)
            for (verdict, reason), values in alike.items():
                felt = felt_n[verdict, reason]
                figure = "–"
                if felt:
                    low_n, high_n = float(np.min(felt)), float(np.max(felt))
                    figure = f"felt {force_text(low_n)} to {force_text(high_n)} from then on"
                what = f"{name}, one {place} of {', '.join(values)} N"
                yield CaseResult(case, what, verdict, figure, reason)


def _run_odd(
    case: str, setup: LoopSetup, place: str, odd_n: float
) -> tuple[CaseResult, list[Array]]:
    """Return the result, and the felt force since the odd sample where the loop ran."""
    hard = HardCase(case, "", setup, ticks=TICKS, disturbed_at=ODD_AT)
    if place == "reference":
        hard = replace(
            hard,
            explanation="Safety bounds force and slew of the reference",
            reference=lambda tick: odd_n if tick == ODD_AT else HELD_N,
        )
    else:
        hard = replace(
            hard,
            explanation="the drive's limits bound the effect of one reading",
            reading=lambda tick, reading_n: odd_n if tick == ODD_AT else reading_n,
        )
    felt_n: list[Array] = []

    def keep(result: CaseResult, run: CaseRun) -> CaseResult:
        felt_n.append(run.felt_n[ODD_AT:])
        return result

    return evaluate(hard, keep), felt_n


def _number_text(value: float) -> str:
    if math.isnan(value):
        return "NaN"
    sign = "−" if value < 0 else ""
    return sign + f"{abs(value)!r}".removesuffix(".0").replace("inf", "∞")


def peer_frames() -> Iterator[CaseResult]:
    """Send a display frames with odd values in every sample of every other frame."""
    for odd_n, text in (
        (math.nan, "NaN"),
        (math.inf, "∞"),
        (-math.inf, "−∞"),
        (5e-324, "5e-324 N"),
        (1e308, "1e308 N"),
        (-1e308, "−1e308 N"),
    ):
        yield _streamed(f"every other frame of a peer holds {text}", odd_n, published.LAYER)
    for modulus_pa in (1e-300, 1e-303):
        name = f"a peer's layer has E = {modulus_pa:g} Pa"
        try:
            layer = ElasticLayer(young_modulus_pa=modulus_pa)
        except ValueError as error:
            # The display decodes a peer's description with this same class.
            yield CaseResult("a peer's samples", name, CaseVerdict.REFUSED, "–", str(error))
        else:
            yield _streamed(name, HELD_N, layer)


def _streamed(name: str, odd_n: float, layer: ElasticLayer) -> CaseResult:
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
    felt_n, frames, odd_frames = [], 0, 0
    for tick in range(STREAM_TO_MS):
        now_ns = tick * MS
        felt_n.append(display.tick(now_ns).felt_n)
        _answer(display, stream, now_ns)
        if tick >= STREAM_FROM_MS and tick % BATCH == 0:
            odd = frames % 2 == 1
            values = np.full((BATCH, 1), odd_n if odd else HELD_N)
            frame = Frame(SESSION, frames * BATCH, now_ns - (BATCH - 1) * MS, MS, values)
            display.on_frame(encode_frame(frame), now_ns)
            frames, odd_frames = frames + 1, odd_frames + odd
    refused = display.receiver.rejected["not_finite"]
    figure = f"{refused} of {odd_frames} odd frames refused, felt at most {force_text(max(felt_n))}"
    verdict, reason = _judge_stream(display, felt_n, refused == odd_frames)
    return CaseResult("a peer's samples", name, verdict, figure, reason)


def _answer(display: Display, stream: StreamDescription, now_ns: int) -> None:
    """Answer a display's requests as a sensing node does, on the display's own clock."""
    for request in display.requests(now_ns):
        match request:
            case Hello():
                display.on_control(encode_control(Welcome(SESSION, 0, stream)), now_ns)
            case ClockRequest(t1_ns=t1_ns):
                reply = ClockReply(SESSION, t1_ns, now_ns, now_ns)
                display.on_control(encode_control(reply), now_ns)
            case _:
                pass


def _judge_stream(
    display: Display, felt_n: list[float], all_refused: bool
) -> tuple[CaseVerdict, str]:
    ratio, limit_n = display.force_ratio, SAFETY.force_limit_n
    if not (0 < ratio < math.inf and np.isfinite(felt_n).all()):
        return CaseVerdict.WRONG, f"accepts a force ratio of {ratio:g}".replace("inf", "∞")
    if max(felt_n) > limit_n:
        return CaseVerdict.WRONG, f"felt beyond the limit of {limit_n:g} N"
    if all_refused:
        reason = "a frame with a sample that is not finite is counted, not played"
        return CaseVerdict.REFUSED, reason
    if ratio * HELD_N > limit_n:
        reason = f"force ratio {ratio:.3g}; Safety holds the limit of {limit_n:g} N"
        return CaseVerdict.STABLE, reason
    return CaseVerdict.STABLE, "Safety bounds force and slew of the buffer's output"


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
                yield CaseResult(name, what, CaseVerdict.REFUSED, "–", str(error))
            else:
                yield _layer(name, what, layer)


def _layer(name: str, what: str, layer: ElasticLayer) -> CaseResult:
    strain, paper = layer.strain(1.0), published.LAYER
    ratios = matching_force_ratio(paper, layer), matching_force_ratio(layer, paper)
    figure = f"strain of 1 N {strain:.4g}, force ratios {ratios[0]:.4g} and {ratios[1]:.4g}"
    off = abs(layer.force(strain) - 1)
    if not np.isfinite([strain, *ratios]).all() or 0 in ratios or off > EXACT:
        reason = "a force ratio that is no usable number is not refused"
        return CaseResult(name, what, CaseVerdict.WRONG, figure.replace("inf", "∞"), reason)
    reason = f"finite; there and back off by {off:.1g}"
    return CaseResult(name, what, CaseVerdict.STABLE, figure, reason)


def exact_steps() -> Iterator[CaseResult]:
    """Step each model over 100 ms: in one tick, and in ticks of 1 µs."""
    models: dict[str, Callable[[int], float]] = {
        "eq 22 under a held voltage": _held,
        "rotor at 100 Hz, ζ = 0.2, on a ramp": lambda ticks: _turned(0.2, ticks),
        "rotor at 100 Hz, ζ = 0, on a ramp": lambda ticks: _turned(0.0, ticks),
        "low-pass of 40 Hz, 1 pole, on a ramp": lambda ticks: _filtered(1, ticks),
        "low-pass of 40 Hz, 4 poles, on a ramp": lambda ticks: _filtered(4, ticks),
    }
    for name, model in models.items():
        once, often = model(1), model(SHORT_TICKS)
        off = abs(often / once - 1)
        yield CaseResult(
            "extreme ticks",
            f"{name}, one tick of 100 ms and {SHORT_TICKS} of 1 µs",
            CaseVerdict.STABLE if off < EXACT else CaseVerdict.WRONG,
            f"{off:.1g} apart",
            "exact at any tick" if off < EXACT else "the two should agree",
        )


def _held(ticks: int) -> float:
    model = SecondOrder(published.ACTUATOR, LONG_S / ticks)
    for _ in range(ticks):
        model.step(1.0)
    return model.force_n


def _turned(damping: float, ticks: int) -> float:
    model = Rotor(UNDAMPED_HZ, damping, LONG_S / ticks)
    for tick in range(ticks):
        model.step(tick / ticks, (tick + 1) / ticks)
    return model.position_m


def _filtered(order: int, ticks: int) -> float:
    model = LowPass(FILTER_HZ, order, LONG_S / ticks)
    for tick in range(ticks):
        model.advance(tick / ticks)
    return model.output(1.0)
