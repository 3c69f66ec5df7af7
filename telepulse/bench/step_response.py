"""How an identified actuator answers a step."""

from dataclasses import dataclass

import numpy as np

from telepulse.bench.response import Input, Model, respond

POINTS = 4_000
SETTLED = 0.02
LEAST_DAMPING = 0.02


@dataclass(frozen=True, slots=True)
class StepResponse:
    """rise_s: from 10 to 90 %; overshoot: beyond the end value, as a share of it; settling_s:
    from the command until it stays within 2 %, the latency included."""

    rise_s: float
    overshoot: float
    settling_s: float


def step_response(model: Model) -> StepResponse:
    """The response of eq 22 to a step."""
    damping = max(model.damping, LEAST_DAMPING)
    horizon_s = 10 * max(1 / damping, 2 * damping) / (2 * np.pi * model.resonance_hz)
    t_s = np.linspace(0.0, horizon_s, POINTS)
    values = np.ones(POINTS)
    values[0] = 0.0
    undelayed = Model(model.m, model.c, model.k)
    share = model.k * respond(undelayed, Input(values, float(t_s[1]), held=True), t_s)
    reached = [t_s[np.argmax(share >= level)] for level in (0.1, 0.9)]
    outside = np.flatnonzero(np.abs(share - 1) > SETTLED)
    return StepResponse(
        rise_s=float(reached[1] - reached[0]),
        overshoot=max(0.0, float(share.max()) - 1),
        settling_s=model.latency_s + float(t_s[outside[-1]]),
    )
