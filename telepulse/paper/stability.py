"""The paper's gains over tick rates: a textbook's explicit PID beside the shipped one.

`control/linear_loop.py` computes the shipped loop's poles and margins.
"""

import math
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.control.linear_loop import UnstableLoopError, linear_loop, margins
from display_node.control.scene import SafetyScene
from display_node.plant.second_order import SecondOrder
from display_node.scene import DisplayScene
from telepulse.document import Table
from telepulse.paper import published
from telepulse.paper.explicit_loop import close_loop, spectral_radius
from telepulse.paper.published import GAINS, Gains
from telepulse.paper.pulse_spectrum import beats, deviation_n

Array = NDArray[np.float64]
RATES_HZ = (100.0, 200.0, 500.0, 1_000.0, 2_000.0, 5_000.0, 10_000.0)
# The filter of the display's scene, and one so far above every tick rate that it has no effect.
FILTERS_HZ = (200.0, 100_000.0)
NO_FILTER_HZ = max(FILTERS_HZ)
SECONDS = 2.0
SETTLING_S = 1.0
PEAK_TO_PEAK_N = 0.3
# Force at which the shipped loop is linearised: a typical mean of a pulse.
HELD_N = 0.3
FREQUENCIES = 400
# The shortest ramp, so that it does not hide what the loop itself does.
SAFETY = SafetyScene.model_validate({"ramp": "1 ms"})
# Felt force beyond this, pressing or pulling, is out of bounds: the fault level of `ForceBounds`.
BOUND_N = SAFETY.overforce_n


def paper_setup(gains: Gains, filter_hz: float = 200.0, tick_s: float = 1e-3) -> DisplayScene:
    """Return the paper's loop as the display runs it: error in mV (eq 21), actuator eq 22.

    tick_s: need not be one that a scene may have.
    """
    controller = {"error": "millivolts", "derivative_filter": f"{filter_hz} Hz", **gains._asdict()}
    tables = {"controller": controller, "actuator": dict(published.ACTUATOR), "safety": SAFETY}
    setup = DisplayScene.model_validate(tables)
    return setup.model_copy(update={"tick_ns": round(1e9 * tick_s)})


class RateResult(NamedTuple):
    """One gain set at one tick rate.

    explicit_radius, shipped_radius: the largest pole, stable below 1. explicit_n, shipped_n,
    late_n: force RMSE in N, infinite where the loop diverged; late: the shipped loop, its film read
    a tick late. margin_ticks: delay margin of the shipped loop. refused: the display's reason not
    to run it, or None.
    """

    gains: str
    filter_hz: float
    rate_hz: float
    explicit_radius: float
    shipped_radius: float
    explicit_n: float
    shipped_n: float
    late_n: float
    margin_ticks: float
    refused: str | None

    @property
    def is_worse_late(self) -> bool:
        """True where the loop errs more than no force at all, with its film read a tick late."""
        return self.late_n > PEAK_TO_PEAK_N * deviation_n("paper")


def measure() -> list[RateResult]:
    """Run both gain sets, with and without a filter, at every rate."""
    return [_run(*case) for case in product(GAINS, FILTERS_HZ, RATES_HZ)]


def _run(name: str, filter_hz: float, rate_hz: float) -> RateResult:
    gains, tick_s = GAINS[name], 1 / rate_hz
    # The pulse begins at 0 N: a step at the start would excite a small ki's slow mode, which lasts
    # longer than the run.
    shape = beats("paper", rate_hz, SECONDS)
    wanted_n = PEAK_TO_PEAK_N * (shape - shape[0])
    setup = paper_setup(gains, filter_hz, tick_s)
    layer = setup.layer.layer()
    linear = linear_loop(setup.controller, setup.actuator, layer, setup.film, tick_s, HELD_N)
    found = margins(linear, FREQUENCIES)
    shipped_n, late_n, refused = math.inf, math.inf, None
    try:
        shipped_n, late_n = (_shipped_rmse_n(setup, wanted_n, late) for late in (False, True))
    except UnstableLoopError as error:
        refused = error.reason
    return RateResult(
        name,
        filter_hz,
        rate_hz,
        spectral_radius(rate_hz, gains, 2 * math.pi * filter_hz),
        found.pole_radius,
        _explicit_rmse_n(gains, filter_hz, wanted_n, tick_s),
        shipped_n,
        late_n,
        found.delay_s / tick_s,
        refused,
    )


def _shipped_rmse_n(setup: DisplayScene, wanted_n: Array, late: bool) -> float:
    loop, reference_n = setup.force_loop(), wanted_n.tolist()
    reading_n, felt_n = 0.0, []
    for tick in range(len(reference_n) - 1):
        before_n, reading_n = reading_n, loop.read_film()
        loop.tick(reference_n[tick : tick + 2], before_n if late else reading_n)
        felt_n.append(loop.felt_n)
    return _rmse_n(felt_n, wanted_n, setup.tick_ns * 1e-9)


def _explicit_rmse_n(gains: Gains, filter_hz: float, wanted_n: Array, tick_s: float) -> float:
    step, reference_n = SecondOrder(published.ACTUATOR, tick_s).step, wanted_n.tolist()[:-1]
    felt_n = close_loop(step, tick_s, reference_n, gains, filter_hz)
    return _rmse_n(felt_n, wanted_n, tick_s)


def _rmse_n(felt_n: list[float], wanted_n: Array, tick_s: float) -> float:
    if not np.abs(felt_n).max() <= BOUND_N:
        return math.inf
    error_n = (np.array(felt_n) - wanted_n[1:])[round(SETTLING_S / tick_s) :]
    return float(np.sqrt(np.mean(error_n**2)))


def rates_table(rates: list[RateResult]) -> Table:
    """Return poles, errors and delay margins by gains, filter and tick rate."""

    def pole(radius: float) -> str:
        return f"{radius:.3g}" if radius >= 1 else f"1 − {1 - radius:.1e}"

    def rmse(force_n: float) -> str:
        return "diverges" if math.isinf(force_n) else f"{1e3 * force_n:.3g} mN"

    filters = {hz: "none" if hz == NO_FILTER_HZ else f"{hz:g} Hz" for hz in FILTERS_HZ}
    rows = [
        {
            "gains, derivative's filter": f"{each.gains}, {filters[each.filter_hz]}",
            "tick rate": f"{each.rate_hz:g} Hz",
            "explicit, pole": pole(each.explicit_radius),
            "explicit": rmse(each.explicit_n),
            "shipped, pole": pole(each.shipped_radius),
            "shipped": each.refused or rmse(each.shipped_n),
            "delay margin": f"{each.margin_ticks:.2f}",
            "a tick late": each.refused or rmse(each.late_n),
        }
        for each in rates
    ]
    summary = f"{len(rows)} loops; all of them are on the page and in the JSON."
    return Table.of("", rows, summary=summary)
