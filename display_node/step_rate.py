"""Step rate (the paper's VCO) and direction logic: a control output becomes steps."""

from typing import NamedTuple


class StepCommand(NamedTuple):
    """What a stepper drive is told: steps a second (never negative), and which way (±1, 0)."""

    rate_hz: float
    direction: int


AT_REST = StepCommand(0.0, 0)


class StepRate:
    """The paper's VCO and direction logic: a control output becomes step rate and direction."""

    def __init__(self, hz_per_unit: float, max_rate_hz: float) -> None:
        self._hz_per_unit = hz_per_unit
        self._max_rate_hz = max_rate_hz

    def command(self, output: float) -> StepCommand:
        """Rate by the magnitude, direction by the sign; at rest without an output."""
        size = abs(output)
        if not size:
            return AT_REST
        rate_hz = min(size * self._hz_per_unit, self._max_rate_hz)
        return StepCommand(rate_hz, 1 if output > 0 else -1)
