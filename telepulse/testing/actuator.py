"""Conformance of actuators: models that a controller and its stability check rely on."""

import itertools
import math
import random
from collections.abc import Mapping
from typing import Any

from display_node.control.linear_loop import read_state, state_variables, write_state
from display_node.plant.scene import ActuatorScene, ForceModel, StepperScene
from protocol.tactile import ElasticLayer
from telepulse.testing.conformance import call_within, read_table, require

TICK_S = 1e-3
TICKS = 500
# Relative error that rounding may cause.
ROUNDING = 1e-6
DEPTHS_M = (1e-5, 1e-4, 5e-4)


def check_actuator(section: type[ActuatorScene], keys: Mapping[str, Any]) -> None:
    """Check a kind of actuator, at a tick of 1 ms.

    Each step must be as `drift` and `response` predict it, the model linear, and each variable of
    its state named by `STATE`: the stability check would miss others. The limit of the output must
    be positive, and the force of a contact law rise with the depth.
    """
    table = read_table(section, keys)
    require(table.output_limit > 0, f"output_limit is {table.output_limit}: it must be positive")
    if table.stepper is not None:
        _check_stepper(table.stepper)
        return

    def build() -> ForceModel:
        return call_within(10.0, "build", lambda: table.build(TICK_S))

    size = min(table.output_limit, 1.0)
    numbers = random.Random(1)
    outputs = [numbers.uniform(-size, size) for _ in range(TICKS)]
    model = build()
    require(model.force_n == 0.0, "the force before the first step is not 0")
    require(model.response > 0, "response is not positive: a larger output must press more")
    forces_n = _run(model, outputs)
    _check_linear(build(), outputs, forces_n)
    _check_state(model, build(), outputs)
    used, fresh = model, build()
    for each in (used, fresh):
        each.place(0.5)
        require(math.isclose(each.force_n, 0.5), "place(0.5) does not set force_n to 0.5")
    same = _near(_run(used, outputs), _run(fresh, outputs))
    require(same, "place leaves a part of the state as it was: it must set the model at rest")


def _run(model: ForceModel, outputs: list[float]) -> list[float]:
    """Return the forces of a model, each of which must be as `drift` and `response` predict it."""
    forces_n = []
    for number, output in enumerate(outputs):
        expected_n = model.force_n + model.drift() + model.response * output
        force_n = model.step(output)
        require(math.isfinite(force_n), f"the force after {number + 1} steps is {force_n}")
        require(force_n == model.force_n, "step returns another force than force_n")
        scale = max(abs(force_n), abs(expected_n), abs(model.response * output))
        require(
            abs(force_n - expected_n) <= ROUNDING * scale,
            f"step {number + 1} gives {force_n:.6g} N, and force_n + drift() + response * output is"
            f" {expected_n:.6g} N: the controller would rely on the latter",
        )
        forces_n.append(force_n)
    return forces_n


def _check_linear(model: ForceModel, outputs: list[float], forces_n: list[float]) -> None:
    doubled = _run(model, [2 * output for output in outputs])
    require(
        _near(doubled, [2 * force_n for force_n in forces_n]),
        "twice the output gives not twice the force: the model must be linear (limits of the output"
        " belong into output_limit), and the same for each build",
    )


def _check_state(model: ForceModel, other: ForceModel, outputs: list[float]) -> None:
    """Check that a model with the same state variables behaves the same."""
    pairs = zip(state_variables([model]), state_variables([other]), strict=True)
    names = []
    for (holder, key), (target, name) in pairs:
        write_state(target, name, read_state(holder, key))
        names.append(str(key))
    require(
        _near(_run(other, outputs), _run(model, outputs)),
        f"it has state that STATE ({', '.join(names)}) does not name: the stability check would not"
        " see it",
    )


def _near(found: list[float], wanted: list[float]) -> bool:
    scale = max(map(abs, wanted)) or 1.0
    return all(abs(a - b) <= ROUNDING * scale for a, b in zip(found, wanted, strict=True))


def _check_stepper(table: StepperScene) -> None:
    """Check the contact law of an actuator that speeds drive."""
    law = table.contact(ElasticLayer())
    forces_n = [law.force(depth_m) for depth_m in (0.0, *DEPTHS_M)]
    require(forces_n[0] == 0.0, "the contact law gives a force at first touch")
    rising = all(a < b for a, b in itertools.pairwise(forces_n))
    require(rising, "the force of the contact law does not rise with the depth")
    for depth_m, force_n in zip(DEPTHS_M, forces_n[1:], strict=True):
        back_m = law.position(force_n)
        require(
            math.isclose(back_m, depth_m, rel_tol=1e-3),
            f"position({force_n:.4g} N) of the contact law is {back_m:.4g} m, and force has"
            f" {depth_m:.4g} m there",
        )
    require(table.step_m > 0, "step_m is not positive")
