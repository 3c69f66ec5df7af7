"""Hard inputs: spikes, denormals and what is no number, in reference, reading and samples."""

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from display_node.display import Display
from display_node.scene import DisplayScene
from protocol.tactile import ElasticLayer
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
from telepulse.reports.paper import numbers
from telepulse.reports.paper.stability import (
    HELD_N,
    SAFETY,
    TICK_S,
    Setup,
    StabilityOutcome,
    StabilityRun,
    StabilityTrial,
    StabilityVerdict,
    judged,
    newtons,
    ran,
    setup,
    shipped,
)
from telepulse.reports.paper.stability_rates import papers

ODD_AT = 500
TICKS = 1000
SPIKES_N = (100.0, -100.0, 1e30, -1e30)
NO_FORCES_N = (5e-324, math.nan, math.inf, -math.inf)
MS = 1_000_000
SESSION = 1
BATCH = 5
STREAM_FROM_MS, STREAM_TO_MS = 500, 2000


def loops() -> dict[str, Setup]:
    """The loops that get every input: both actuators, with and without an observer or kd."""
    return {
        "the experiment's gains on eq 22": papers(numbers.EXPERIMENT, 200.0, TICK_S),
        "scenes/bench.toml": shipped("bench"),
        "scenes/real_bench.toml": shipped("real_bench"),
        "PID on force with kd": setup({"kp": 0.1, "kd": 1e-4}, {"kind": "stepper"}),
    }


def spikes() -> Iterator[StabilityOutcome]:
    """One sample of far too much, as the reference and as the film's reading."""
    yield from _odd("a force spike", SPIKES_N)


def no_forces() -> Iterator[StabilityOutcome]:
    """One sample that is hardly a number or none, as the reference and as the reading."""
    yield from _odd("denormals and NaN", NO_FORCES_N)


def _odd(case: str, odd_n: tuple[float, ...]) -> Iterator[StabilityOutcome]:
    """One row for all samples with one verdict and reason."""
    for name, loop in loops().items():
        for place in ("reference", "reading"):
            alike: dict[tuple[StabilityVerdict, str], list[tuple[str, StabilityRun | None]]] = {}
            for value_n in odd_n:
                trial = _trial(case, loop, place, value_n)
                done = ran(trial)
                outcome = done if isinstance(done, StabilityOutcome) else judged(trial, done)
                row = alike.setdefault((outcome.verdict, outcome.reason), [])
                row.append((_told(value_n), done if isinstance(done, StabilityRun) else None))
            for (verdict, reason), found in alike.items():
                values = ", ".join(told for told, _ in found)
                what = f"{name}, one {place} of {values} N"
                yield StabilityOutcome(
                    case, what, verdict, _span([done for _, done in found]), reason
                )


def _trial(case: str, loop: Setup, place: str, odd_n: float) -> StabilityTrial:
    trial = StabilityTrial(case, "", loop, ticks=TICKS, since=ODD_AT)
    if place == "reference":
        return replace(
            trial,
            why="Safety bounds force and slew of the reference",
            reference=lambda tick: odd_n if tick == ODD_AT else HELD_N,
        )
    return replace(
        trial,
        why="the drive's limits bound what one reading can do",
        reading=lambda tick, reading_n: odd_n if tick == ODD_AT else reading_n,
    )


def _told(value_n: float) -> str:
    if math.isnan(value_n):
        return "NaN"
    sign = "−" if value_n < 0 else ""
    return sign + f"{abs(value_n)!r}".removesuffix(".0").replace("inf", "∞")


def _span(runs: list[StabilityRun | None]) -> str:
    """Between which forces all the runs were felt since the odd sample."""
    felt_n = [done.felt_n[ODD_AT:] for done in runs if done is not None]
    if not felt_n:
        return "–"
    low_n, high_n = float(np.min(felt_n)), float(np.max(felt_n))
    return f"felt {newtons(low_n)} to {newtons(high_n)} from then on"


def peers() -> Iterator[StabilityOutcome]:
    """Frames of a peer to a whole display: each of these in every sample of every other frame."""
    for odd_n, told in (
        (math.nan, "NaN"),
        (math.inf, "∞"),
        (-math.inf, "−∞"),
        (5e-324, "5e-324 N"),
        (1e308, "1e308 N"),
        (-1e308, "−1e308 N"),
    ):
        yield _streamed(f"every other frame of a peer holds {told}", odd_n, numbers.LAYER)
    for modulus_pa in (1e-300, 1e-303):
        what = f"a peer's layer has E = {modulus_pa:g} Pa"
        try:
            layer = ElasticLayer(young_modulus_pa=modulus_pa)
        except ValueError as error:
            # The display reads a peer's description with this same class.
            yield StabilityOutcome(
                "a peer's samples", what, StabilityVerdict.REFUSED, "–", str(error)
            )
        else:
            yield _streamed(what, HELD_N, layer)


def _streamed(what: str, odd_n: float, layer: ElasticLayer) -> StabilityOutcome:
    """Feed a display for some seconds; what it felt, refused and found faulty."""
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
            first_ns = now_ns - (BATCH - 1) * MS
            display.on_frame(
                encode_frame(Frame(SESSION, frames * BATCH, first_ns, MS, values)), now_ns
            )
            frames, odd_frames = frames + 1, odd_frames + odd
    refused = display.receiver.rejected["not_finite"]
    figure = f"{refused} of {odd_frames} odd frames refused, felt at most {newtons(max(felt_n))}"
    verdict, reason = _seen(display, felt_n, refused == odd_frames)
    return StabilityOutcome("a peer's samples", what, verdict, figure, reason)


def _answer(display: Display, stream: StreamDescription, now_ns: int) -> None:
    """What a sensing node answers to a display's requests; its clock is the display's."""
    for request in display.requests(now_ns):
        match request:
            case Hello():
                display.on_control(encode_control(Welcome(SESSION, 0, stream)), now_ns)
            case ClockRequest(t1_ns=t1_ns):
                reply = ClockReply(SESSION, t1_ns, now_ns, now_ns)
                display.on_control(encode_control(reply), now_ns)
            case _:
                pass


def _seen(display: Display, felt_n: list[float], refused: bool) -> tuple[StabilityVerdict, str]:
    ratio, limit_n = display.force_ratio, SAFETY.force_limit_n
    if not (0 < ratio < math.inf and np.isfinite(felt_n).all()):
        return StabilityVerdict.WRONG, f"takes a force ratio of {ratio:g}".replace("inf", "∞")
    if max(felt_n) > limit_n:
        return StabilityVerdict.WRONG, f"felt beyond the limit of {limit_n:g} N"
    if refused:
        return (
            StabilityVerdict.REFUSED,
            "a frame with a sample that is not finite is counted, not played",
        )
    if ratio * HELD_N > limit_n:
        return (
            StabilityVerdict.STABLE,
            f"force ratio {ratio:.3g}; Safety holds the limit of {limit_n:g} N",
        )
    return StabilityVerdict.STABLE, "Safety bounds force and slew of what the buffer gives"
