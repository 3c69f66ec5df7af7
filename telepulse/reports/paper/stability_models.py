"""Hard cases of the models: Poisson's ratio, a vanishing layer, one step of 100 ms for 100 000."""

from collections.abc import Callable, Iterator

import numpy as np

from display_node.plant.filters import LowPass
from display_node.plant.second_order import SecondOrder
from display_node.plant.stepper import Rotor
from protocol.tactile import ElasticLayer, matching_force_ratio
from telepulse.reports.paper import numbers
from telepulse.reports.paper.stability import StabilityOutcome, StabilityVerdict

LONG_S = 0.1
SHORT_TICKS = 100_000
EXACT = 1e-9
UNDAMPED_HZ = 100.0
FILTER_HZ = 40.0


def layers() -> Iterator[StabilityOutcome]:
    """Strain of 1 N, there and back, and the force ratio against Table 3's layer, both ways."""
    for name, key, values in (
        ("ν → 0.5", "poisson_ratio", (0.0, 0.4999999, 0.5, 0.5000001)),
        ("vanishing thickness", "thickness_m", (1e-12, 1e-300, 5e-324, 0.0)),
        ("vanishing modulus", "young_modulus_pa", (1e-300, 1e-303)),
    ):
        for value in values:
            yield _layer(name, key, value)


def _layer(name: str, key: str, value: float) -> StabilityOutcome:
    symbol = {"poisson_ratio": "ν", "thickness_m": "d", "young_modulus_pa": "E"}[key]
    unit = {"poisson_ratio": "", "thickness_m": " m", "young_modulus_pa": " Pa"}[key]
    what = f"{symbol} = {value!r}{unit}, against Table 3"
    try:
        layer = ElasticLayer(**{key: value})
    except ValueError as error:
        return StabilityOutcome(name, what, StabilityVerdict.REFUSED, "–", str(error))
    strain = layer.strain(1.0)
    ratios = matching_force_ratio(numbers.LAYER, layer), matching_force_ratio(layer, numbers.LAYER)
    figure = f"strain of 1 N {strain:.4g}, force ratios {ratios[0]:.4g} and {ratios[1]:.4g}"
    off = abs(layer.force(strain) - 1)
    if not np.isfinite([strain, *ratios]).all() or 0 in ratios or off > EXACT:
        reason = "a force ratio that is no usable number is not refused"
        return StabilityOutcome(
            name, what, StabilityVerdict.WRONG, figure.replace("inf", "∞"), reason
        )
    return StabilityOutcome(
        name, what, StabilityVerdict.STABLE, figure, f"finite; there and back off by {off:.1g}"
    )


def exact_steps() -> Iterator[StabilityOutcome]:
    """Each model over 100 ms: in one step, and in steps of 1 µs."""
    models: dict[str, Callable[[int], float]] = {
        "eq 22 under a held voltage": _held,
        "rotor at 100 Hz, ζ = 0.2, on a ramp": lambda ticks: _turned(0.2, ticks),
        "rotor at 100 Hz, ζ = 0, on a ramp": lambda ticks: _turned(0.0, ticks),
        "low-pass of 40 Hz, 1 pole, on a ramp": lambda ticks: _filtered(1, ticks),
        "low-pass of 40 Hz, 4 poles, on a ramp": lambda ticks: _filtered(4, ticks),
    }
    for what, model in models.items():
        once, often = model(1), model(SHORT_TICKS)
        off = abs(often / once - 1)
        yield StabilityOutcome(
            "extreme ticks",
            f"{what}, one tick of 100 ms and {SHORT_TICKS} of 1 µs",
            StabilityVerdict.STABLE if off < EXACT else StabilityVerdict.WRONG,
            f"{off:.1g} apart",
            "exact at any tick" if off < EXACT else "the two ought to agree",
        )


def _held(ticks: int) -> float:
    model = SecondOrder(numbers.ACTUATOR, LONG_S / ticks)
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
