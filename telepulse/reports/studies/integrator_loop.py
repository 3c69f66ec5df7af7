"""The loop that the study of integrators closes: the paper's pulse, a discrete PID, a stepper.

The PID is written out here, apart from the display's, so that every integrator meets the same
one and so that it also runs in decimals.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from decimal import Decimal, localcontext
from typing import Generic

import numpy as np

from protocol.tactile import Film
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource
from telepulse.reports.studies.integrators import Number, Plant, Step, held_matrix

# Table 5, the experiment's gains, read as acting on an error in mV by eq 21 at the display's
# film; the derivative's filter is not the paper's but that of our scene.
KP, KI, KD = 15.0, 0.15, 0.03
DERIVATIVE_FILTER_HZ = 200.0
MILLIVOLTS_PER_NEWTON = 1e3 * Film(9e-3).volts_per_newton

Memory = tuple[Number, Number, Number]
"""What the PID keeps: its integral in V, its filtered derivative in V, the last error in N."""


def pulse_from_rest(scene: SyntheticScene, seconds: float, tick_s: float) -> list[float]:
    """A synthetic pulse once a tick, in N above its first sample, so that it begins at rest."""
    source = SyntheticSource(scene.model_copy(update={"rate_hz": 1 / tick_s}))
    force_n = source.take(round(seconds / tick_s))[:, 0]
    risen_n: list[float] = (force_n - force_n[0]).tolist()
    return risen_n


@dataclass(frozen=True, slots=True)
class DiscretePid(Generic[Number]):
    """A discrete PID's gains a tick, from an error in N to a voltage in V."""

    proportional: Number
    integral: Number
    derivative: Number
    keep: Number


def paper_pid(tick_s: float) -> DiscretePid[float]:
    """The experiment's gains; integral, derivative and its filter by backward Euler."""
    filter_s = 1 / (2 * math.pi * DERIVATIVE_FILTER_HZ)
    return DiscretePid(
        KP * MILLIVOLTS_PER_NEWTON,
        KI * MILLIVOLTS_PER_NEWTON * tick_s,
        KD * MILLIVOLTS_PER_NEWTON / (filter_s + tick_s),
        filter_s / (filter_s + tick_s),
    )


def pid_step(
    pid: DiscretePid[Number], memory: Memory[Number], error_n: Number
) -> tuple[Number, Memory[Number]]:
    """One tick of the PID: the voltage, and what it keeps."""
    integral, derivative, last_n = memory
    integral = integral + pid.integral * error_n
    derivative = pid.keep * derivative + pid.derivative * (error_n - last_n)
    volts = pid.proportional * error_n + integral + derivative
    return volts, (integral, derivative, error_n)


def close_loop(
    step: Step[Number], pid: DiscretePid[Number], reference_n: Sequence[Number]
) -> tuple[list[Number], list[Number]]:
    """Follow a reference from rest: the force in N after each tick, the voltage held in it."""
    force_n = reference_n[0] * 0
    memory = (force_n, force_n, force_n)
    forces_n, voltages = [], []
    for wanted_n in reference_n:
        volts, memory = pid_step(pid, memory, wanted_n - force_n)
        force_n = step(volts)
        forces_n.append(force_n)
        voltages.append(volts)
    return forces_n, voltages


def hold_open(step: Step[Number], voltages: Iterable[Number]) -> list[Number]:
    """Without a controller: the force in N after each tick of given voltages."""
    return [step(volts) for volts in voltages]


def decimals(numbers: Iterable[float]) -> list[Decimal]:
    """Floats as decimals, digit for digit."""
    return [Decimal(number) for number in numbers]


def decimal_plant(plant: Plant[float]) -> Plant[Decimal]:
    """A plant as decimals, digit for digit."""
    return Plant(*decimals((plant.m, plant.c, plant.k)))


def decimal_pid(pid: DiscretePid[float]) -> DiscretePid[Decimal]:
    """A PID as decimals, digit for digit."""
    return DiscretePid(*decimals((pid.proportional, pid.integral, pid.derivative, pid.keep)))


def loop_radius(plant: Plant[float], tick_s: float) -> float:
    """Spectral radius of the closed loop's map from tick to tick; below 1 it is stable."""
    with localcontext(prec=40):
        held = held_matrix(decimal_plant(plant), Decimal(tick_s))
    (a11, a12, b1), (a21, a22, b2) = ([float(x) for x in row] for row in held[:2])
    pid, columns = paper_pid(tick_s), []
    # The map is linear: its columns are what becomes of the unit states.
    for force, rate, *memory in np.eye(5).tolist():
        volts, kept = pid_step(pid, (memory[0], memory[1], memory[2]), -force)
        columns.append(
            [a11 * force + a12 * rate + b1 * volts, a21 * force + a22 * rate + b2 * volts, *kept]
        )
    return float(np.abs(np.linalg.eigvals(np.array(columns).T)).max())
