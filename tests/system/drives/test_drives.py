"""Behaviour that every kind of drive must have, each on its real bytes."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial

import pytest

from display_node.drives.withdrawal import WithdrawalOutcome
from tests.support.drive_benches import Bench, cia402_bench, slcan_bench, stepper, tmcl_bench, wait

MakeBench = Callable[..., AbstractContextManager[Bench]]
KINDS = {"tmcl": tmcl_bench, "cia402": cia402_bench}
FURTHER_KINDS = {
    "tmcl-can": partial(tmcl_bench, on_can=True),
    "tmcl-slcan": partial(tmcl_bench, by_slcan=True),
    "cia402-profile": partial(cia402_bench, mode="profile"),
    "cia402-slcan": slcan_bench,
}
RATE_HZ = 400.0


@pytest.fixture(params=KINDS.values(), ids=KINDS.keys())
def make(request: pytest.FixtureRequest) -> MakeBench:
    bench: MakeBench = request.param
    return bench


@pytest.fixture(params=[*KINDS.values(), *FURTHER_KINDS.values()], ids=[*KINDS, *FURTHER_KINDS])
def make_any(request: pytest.FixtureRequest) -> MakeBench:
    bench: MakeBench = request.param
    return bench


def in_steps(bench: Bench, length_m: float) -> float:
    return length_m / bench.actuator.step_m


@pytest.mark.parametrize(
    "keys",
    [{}, {"inverted": True, "velocity_scale": 0.5, "touch": "0.4 mm"}, {"homing": "none"}],
    ids=["as it comes", "inverted, other units", "home is here"],
)
def test_it_homes_comes_to_first_touch_and_runs_at_the_commanded_rate(
    make_any: MakeBench, keys: dict[str, object]
) -> None:
    with make_any(**keys) as bench:
        bench.drive.start()
        status = bench.drive.status()
        assert status.fault is None
        assert not status.moving
        assert abs(in_steps(bench, status.position_m)) < 1.5
        # Where the tip stood at the beginning, half way to the finger, is home without homing.
        home_m = 0.3e-3 if keys.get("homing") == "none" else 0.0
        # The switch is looked at every millisecond, at 5 mm/s: 8 steps.
        assert in_steps(bench, bench.motor.tip_m) == pytest.approx(in_steps(bench, home_m), abs=10)
        for rate_hz in (RATE_HZ, -RATE_HZ):
            bench.keep(rate_hz, lambda wanted=rate_hz: bench.motor.rate_hz == pytest.approx(wanted))


def test_it_does_not_move_before_start_nor_after_close(make: MakeBench) -> None:
    with make() as bench:
        stood_m = bench.motor.tip_m
        bench.drive.command(RATE_HZ * bench.actuator.step_m)
        assert bench.drive.status().fault == "not started"
        assert bench.motor.tip_m == stood_m
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.rate_hz > 0)
        bench.drive.close()
        wait(lambda: bench.at_rest)
        stood_m = bench.motor.tip_m
        bench.drive.command(RATE_HZ * bench.actuator.step_m)
        assert bench.drive.status().fault == "closed"
        assert bench.motor.tip_m == stood_m


def test_what_it_says_is_where_the_motor_is(make: MakeBench) -> None:
    with make() as bench:
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.tip_m > 0.2e-3)
        bench.keep(0.0, lambda: bench.at_rest and not bench.drive.status().moving)
        felt_m = bench.motor.tip_m

        def is_there() -> bool:
            return abs(in_steps(bench, bench.drive.status().position_m - felt_m)) < 10

        bench.keep(0.0, is_there)


def test_the_soft_limit_holds_the_tip_back(make: MakeBench) -> None:
    with make(furthest="0.2 mm") as bench:
        bench.drive.start()
        bench.keep(1e6, lambda: bench.motor.tip_m > 0.17e-3)
        assert bench.motor.tip_m <= 0.2e-3
        bench.keep(-RATE_HZ, lambda: bench.motor.tip_m < 0.1e-3)


@pytest.mark.parametrize("fault", ["overtemperature", "following error"])
def test_a_fault_of_the_drive_is_named_and_the_tip_leaves_as_soon_as_the_drive_obeys(
    make: MakeBench, fault: str
) -> None:
    with make() as bench:
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.tip_m > 0.05e-3)
        bench.motor.fail(fault)  # type: ignore[arg-type]
        bench.keep(RATE_HZ, lambda: bench.drive.status().fault is not None)
        named = (bench.drive.status().fault or "").replace("deviation", "following error")
        assert fault in named
        bench.motor.reset()
        wait(lambda: bench.drive.status().withdrawal is not WithdrawalOutcome.UNDER_WAY)
        wait(lambda: bench.at_rest)
        assert bench.motor.tip_m < 0
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.rate_hz > 0)


def test_a_motor_that_cannot_push_on_is_a_fault(make: MakeBench) -> None:
    with make(actuator=stepper(thrust="0.2 N"), furthest="0.1 mm") as bench:
        bench.drive.start()
        bench.motor.force_n = 0.0
        bench.motor._thrust_n = 1e-6
        bench.keep(RATE_HZ, lambda: bench.drive.status().fault is not None)
        wait(lambda: bench.at_rest)
        assert any(name in str(bench.drive.status().fault) for name in ("stall", "blocked"))


def test_without_commands_for_the_watchdogs_time_the_tip_leaves(make_any: MakeBench) -> None:
    with make_any() as bench:
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.tip_m > 0.05e-3)
        wait(lambda: bench.drive.status().fault is not None)
        wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.WITHDRAWN)
        wait(lambda: bench.at_rest)
        assert bench.motor.tip_m < -0.2e-3
        bench.drive.command(RATE_HZ * bench.actuator.step_m)
        assert bench.at_rest


def test_a_withdrawn_tip_stays_off_the_finger(make: MakeBench) -> None:
    with make() as bench:
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.tip_m > 0.1e-3)
        bench.drive.withdraw("stopped")
        wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.WITHDRAWN)
        wait(lambda: bench.at_rest)
        away_m = bench.motor.tip_m
        assert away_m < -0.2e-3
        for _ in range(100):
            bench.drive.command(RATE_HZ * bench.actuator.step_m)
        assert bench.drive.status().fault == "stopped"
        assert bench.motor.tip_m == away_m
