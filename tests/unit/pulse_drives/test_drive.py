"""Behaviour that every kind of drive has, on emulated drives in virtual time."""

from collections.abc import Iterator
from unittest.mock import patch

import pytest

from protocol.errors import DriveError
from pulse_drives.axis import build_axis
from pulse_drives.drive import OPENED_M, SEARCH_MARGIN_M, TouchGuard, bound_search
from pulse_drives.stepdir.drive import StepdirDrive
from pulse_drives.supervisor import Supervisor
from pulse_drives.withdrawal import WithdrawalOutcome
from pulse_sensors.drive_film import DriveFilmScene
from tests.support.drive_benches import (
    FORCE_LIMIT_N,
    LAYER,
    Bench,
    stepper,
    tmcl_scene,
    virtual_bench,
)
from tests.support.fault_injection import FaultKind, InjectedFault

KINDS = ("tmcl", "tmcl-can", "cia402", "stepdir")
RATE_HZ = 400.0
FILM = DriveFilmScene.model_validate({"kind": "drive", "zero": 8000, "newtons_per_count": 5e-4})


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture
def bench(kind: str) -> Iterator[Bench]:
    with virtual_bench(kind) as bench:
        yield bench


@pytest.mark.parametrize(
    "keys",
    [
        {},
        {"inverted": True, "velocity_scale": 0.5, "touch": "0.4 mm"},
        {"homing": "none"},
        {"homing_method": 17},
        {"mode": "profile"},
    ],
    ids=["defaults", "inverted, other units", "no homing", "homing method", "profile velocity"],
)
def test_a_drive_homes_and_runs_at_the_commanded_rate(kind: str, keys: dict[str, object]) -> None:
    if "tmcl" in kind and keys.keys() & {"mode", "homing_method"}:
        keys = {"homing_method": 1} if "homing_method" in keys else {}
    if kind == "stepdir":
        others = ("mode", "homing_method", "velocity_scale")
        keys = {key: value for key, value in keys.items() if key not in others}
    with virtual_bench(kind, **keys) as bench:
        bench.start()
        status, step_m = bench.drive.status(), bench.actuator.step_m
        assert (status.fault, status.moving) == (None, False)
        assert abs(status.position_m) < 1.5 * step_m
        # Without homing, home is where the tip began, half way to the finger.
        home_m = 0.3e-3 if keys.get("homing") == "none" else 0.0
        # The switch is read every millisecond, at 5 mm/s: 8 steps.
        assert bench.motor.tip_m == pytest.approx(home_m, abs=10 * step_m)
        for rate_hz in (RATE_HZ, -RATE_HZ):
            bench.keep(rate_hz, lambda wanted=rate_hz: bench.motor.rate_hz == pytest.approx(wanted))
        bench.keep(0.0, lambda: bench.at_rest and not bench.drive.status().moving)
        place_m = bench.drive.status().position_m + home_m
        assert place_m == pytest.approx(bench.motor.tip_m, abs=10 * step_m)


def test_before_start_and_after_close_a_drive_does_not_move(bench: Bench) -> None:
    for fault in ("not started", "closed"):
        place_m = bench.motor.tip_m
        bench.drive.command(RATE_HZ * bench.actuator.step_m)
        bench.clock.sleep(0.1)
        assert bench.fault == fault
        assert bench.motor.tip_m == place_m
        bench.start(RATE_HZ)
        bench.drive.close()
        bench.wait(lambda: bench.at_rest)


def test_the_soft_limit_stops_the_tip(kind: str) -> None:
    with virtual_bench(kind, furthest="0.2 mm") as bench:
        bench.start(1e6, 0.17e-3)
        bench.keep(1e6, lambda: bench.drive.status().held_back)
        assert bench.motor.tip_m <= 0.2e-3
        bench.keep(-RATE_HZ, lambda: bench.motor.tip_m < 0.1e-3)
        assert not bench.drive.status().held_back


@pytest.mark.parametrize("fault", ["overtemperature", "following error", "stall"])
def test_after_a_drive_fault_the_tip_withdraws_as_soon_as_the_drive_obeys(
    kind: str, bench: Bench, fault: str
) -> None:
    if (kind, fault) == ("stepdir", "following error"):
        pytest.skip("the board counts the steps that it gives, and a film finds others")
    bench.start(RATE_HZ, 0.05e-3)
    bench.motor.fail(fault)
    bench.keep(RATE_HZ, lambda: bench.fault)
    words = {"following error": ("following error", "deviation"), "stall": ("stall", "blocked")}
    assert any(word in bench.fault for word in words.get(fault, (fault,)))
    bench.motor.reset()
    bench.wait(lambda: bench.drive.status().withdrawal is not WithdrawalOutcome.UNDER_WAY)
    bench.wait(lambda: bench.at_rest)
    assert bench.motor.tip_m < 0
    bench.start(RATE_HZ)


@pytest.mark.parametrize("lasting_ms", [2, 1_000])
def test_an_exception_of_the_line_is_a_fault_and_the_tip_leaves(
    bench: Bench, lasting_ms: int
) -> None:
    """The drive's thread goes on: test_guards.py has every method at every moment."""
    bench.start(RATE_HZ, 0.05e-3)
    name = {"tmcl": "rotate", "cia402": "command", "stepdir": "send_velocity"}
    device = type(bench.drive._device)
    with patch.object(device, name[bench.scene.kind], side_effect=MemoryError):
        until_ns = bench.clock.now_ns + lasting_ms * 1_000_000
        bench.keep(RATE_HZ, lambda: bench.clock.now_ns > until_ns)
    fault = bench.drive.status().fault
    assert fault is not None
    assert "MemoryError" in str(fault)
    bench.wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.WITHDRAWN)
    assert bench.motor.force_n == 0.0


@pytest.mark.parametrize("reason", ["ended", "no command for 5"])
def test_a_withdrawn_tip_stays_off_the_finger(bench: Bench, reason: str) -> None:
    bench.start(RATE_HZ, 0.05e-3)
    if reason == "ended":
        bench.drive.withdraw()
    bench.wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.WITHDRAWN)
    bench.wait(lambda: bench.at_rest)
    away_m = bench.motor.tip_m
    assert away_m < -0.2e-3
    for _ in range(100):
        bench.drive.command(RATE_HZ * bench.actuator.step_m)
        bench.clock.sleep(0.002)
    assert bench.fault.startswith(reason)
    assert bench.motor.tip_m == away_m


def test_the_film_confirms_a_withdrawal(bench: Bench) -> None:
    bench.start(RATE_HZ, 0.2e-3)
    bench.drive.withdraw()
    film = lambda: bench.drive.add_force_reading(bench.motor.force_n, bench.clock.now_ns)  # noqa: E731
    bench.wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.WITHDRAWN, film)
    assert bench.motor.force_n == 0.0


@pytest.mark.parametrize("film", [True, False], ids=["film", "no film"])
def test_a_reversed_motor_is_refused_before_it_presses(kind: str, film: bool) -> None:
    """The motor's wires are swapped, and the drive's count does not show it."""
    with virtual_bench(kind, touch="2 mm", film=FILM) as bench:
        if film and isinstance(bench.drive, StepdirDrive):
            # A board goes back by what its own film shows.
            bench.drive.film_port(*FILM.counts_within(2.7))
        bench.motor.injector.begin(InjectedFault(FaultKind.REVERSED), bench.clock.now_ns)
        forces_n = [0.0]

        def force_n() -> float | None:
            forces_n.append(bench.motor.force_n)
            return forces_n[-1] if film else None

        with pytest.raises(DriveError, match="inverted") as error:
            bench.drive.start(force_n)
        assert error.value.kind == "wrong way"
        assert bench.fault
        bench.wait(lambda: bench.at_rest)
        if film:
            assert max(forces_n) < 0.4
            # A board goes back where its film has shown a 64th of its range some ms before.
            assert bench.motor.force_n < 0.15


def test_a_search_for_home_does_not_outlast_its_host(kind: str) -> None:
    """A motor whose wires are swapped seeks home into the finger, and only the host bounds that."""
    with virtual_bench(kind, touch="2 mm", homing_speed="5 mm/s") as bench:
        bench.motor.injector.begin(InjectedFault(FaultKind.REVERSED), bench.clock.now_ns)
        start = bench.clock.thread(bench.drive.start)
        bench.wait(lambda: bench.motor.homing and bench.motor.rate_hz)
        bench.clock.sleep(0.05)
        bench.clock.stall(list(bench.clock.threads), bench.clock.now_ns + 10**12)
        bench.clock.sleep(0.1)
        assert bench.at_rest
        began_m = bench.motor.tip_m
        bench.clock.sleep(2.0)
        assert bench.motor.tip_m == began_m
        assert start.is_alive()


def test_a_home_switch_that_stays_closed_is_the_wrong_way(kind: str) -> None:
    """The motor turns the wrong way once the search for home has ended."""
    with virtual_bench(kind, touch="0.3 mm") as bench:
        searching = False

        def reverse_after_search() -> None:
            nonlocal searching
            if searching and not bench.motor.homing:
                fault = InjectedFault(FaultKind.REVERSED)
                bench.motor.injector.begin(fault, bench.clock.now_ns)
            searching = bench.motor.homing

        bench.clock.every(1_000_000, reverse_after_search)
        with pytest.raises(DriveError, match=r"the home switch is closed 0\.15 mm from home"):
            bench.drive.start()


@pytest.mark.parametrize("error", [KeyboardInterrupt(), DriveError("no answer", "it is off")])
def test_an_aborted_start_leaves_the_tip_in_place(bench: Bench, error: BaseException) -> None:
    places_m = []

    def force_n() -> float:
        places_m.append(bench.motor.tip_m)
        if len(places_m) > 3:
            raise error
        return 0.0

    with pytest.raises(type(error)):
        bench.drive.start(force_n)
    bench.wait(lambda: bench.at_rest)
    assert bench.fault in ("closed", "not started")
    assert bench.motor.tip_m == pytest.approx(places_m[-1], abs=0.1e-3)


def test_a_drive_that_fails_on_its_way_to_first_touch_is_closed(bench: Bench) -> None:
    reads_after_homing = 0

    def force_n() -> float:
        nonlocal reads_after_homing
        reads_after_homing = 0 if bench.motor.homing else reads_after_homing + 1
        if reads_after_homing == 20:
            bench.motor.fail("overtemperature")
        return 0.0

    with pytest.raises(DriveError, match=r"on its way to first touch: .*overtemperature"):
        bench.drive.start(force_n)
    assert bench.drive.status().withdrawal is None


def test_a_tip_that_does_not_move_ends_the_start(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Supervisor, "velocity_to_send", lambda supervisor, now_ns: 0)
    with pytest.raises(DriveError, match=r"the tip stays 0\.2.. mm before first touch") as error:
        bench.drive.start()
    assert error.value.kind == "not there"


def test_a_press_before_first_touch_ends_the_motion() -> None:
    readings = iter([0.30, 0.28, 0.31, None, 0.37, 0.39])
    guard = TouchGuard(lambda: next(readings))
    for _ in range(4):
        guard()
    with pytest.raises(DriveError, match="the force rises by 110 mN before first touch"):
        guard()


def test_a_search_for_home_ends_where_home_cannot_be() -> None:
    axis = build_axis(tmcl_scene(port="x"), stepper(), stepper().deepest_m(LAYER, FORCE_LIMIT_N))
    assert -axis.lowest_m > OPENED_M
    most_m = axis.furthest_m - axis.lowest_m + SEARCH_MARGIN_M
    bound_search(axis, 1e-3, 1e-3 - 0.99 * most_m)
    for place_m in (1e-3 - 1.01 * most_m, 1e-3 + 1.01 * most_m):
        with pytest.raises(DriveError, match="no home switch found within"):
            bound_search(axis, 1e-3, place_m)
