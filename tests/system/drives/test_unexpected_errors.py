"""Errors that no code expects, in real processes, and ends of a run that may leave a tip pressed.

A display with one altered method, and an emulated drive whose motor is recorded. All methods, at
all moments, are in tests/unit/pulse_drives/test_guards.py, in virtual time.
"""

import signal
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import NamedTuple

import pytest

from protocol.cli_options import FAULT_STATUS
from protocol.faults import FaultKind, faults_of
from protocol.finger import WithdrawalOutcome, finger_in
from tests.support.altered_node import HOMING, RUNNING, STEP, WITHDRAWAL
from tests.support.can_messages import udp_multicast_reason
from tests.support.emulated_bench import EmulatedBench, playing
from tests.support.waiting import until
from tests.system.drives.attempts import PATIENCE_MS, on_bench

KINDS = ("tmcl", "cia402", "stepdir")
WITHIN_S = 20.0
# From an exception to the fault on the screens.
SHOWN_WITHIN_NS = 500_000_000
PLAYED = 500
# After which the drive still obeys.
FAULTS_BEFORE = {"tmcl": "film-silent", "cia402": "film-silent", "stepdir": "reset"}
TMCL, CIA402 = "pulse_drives.tmcl.module:TmclModule", "pulse_drives.cia402.node:Cia402Node"
BOARD = "pulse_drives.stepdir.board:DisplayBoard"
TMCL_LINE = "pulse_drives.tmcl.line:TmclLine"


class Case(NamedTuple):
    """A method that raises an error at a moment."""

    kind: str
    moment: str
    method: str
    error: str


CASES = (
    Case("tmcl", HOMING, f"{TMCL_LINE}.request", "RuntimeError"),
    Case("cia402", HOMING, f"{CIA402}.send_heartbeat", "MemoryError"),
    Case("stepdir", HOMING, f"{BOARD}.refresh", "termios.error"),
    Case("tmcl", RUNNING, f"{TMCL}.rotate", "termios.error"),
    Case("cia402", RUNNING, f"{CIA402}.command", "RuntimeError"),
    Case("stepdir", RUNNING, f"{BOARD}.send_velocity", "MemoryError"),
    Case("tmcl", WITHDRAWAL, f"{TMCL}.read", "MemoryError"),
    Case("cia402", WITHDRAWAL, f"{CIA402}.fault", "termios.error"),
    Case("stepdir", WITHDRAWAL, f"{BOARD}.fault", "RuntimeError"),
)


def cases(*moments: str) -> list[object]:
    """Return the cases of moments; one of them is a smoke test."""
    return [
        pytest.param(
            case,
            id=f"{case.kind}-{case.moment}",
            marks=pytest.mark.smoke if (case.kind, case.moment) == ("tmcl", RUNNING) else (),
        )
        for case in CASES
        if case.moment in moments
    ]


def skip_without_bus(kind: str) -> None:
    if kind == "cia402" and (reason := udp_multicast_reason()) is not None:
        pytest.skip(f"udp_multicast: {reason}")


def on_a_bench(
    folder: Path,
    kind: str,
    happens: Callable[[EmulatedBench], None],
    *options: str,
    alteration: str = "",
) -> EmulatedBench:
    """Return a bench, ended, on which `happens` was called while the pulse was felt."""
    skip_without_bus(kind)

    def started(here: Path) -> AbstractContextManager[EmulatedBench]:
        altered = alteration.format(here=here)
        return playing(
            here, kind, "real_bench", *options, watchdog_ms=PATIENCE_MS, alteration=altered
        )

    return on_bench(folder, started, happens)


def outcome_shown(bench: EmulatedBench) -> WithdrawalOutcome | None:
    return finger_in(bench.await_state("fault")).outcome


def end_display(bench: EmulatedBench) -> int:
    display = bench.processes["display"]
    display.send_signal(signal.SIGTERM)
    return display.wait(WITHIN_S)


@pytest.mark.parametrize("case", cases(RUNNING, WITHDRAWAL))
def test_an_error_that_no_code_expects_is_shown_and_the_tip_leaves(
    case: Case, tmp_path: Path
) -> None:
    def happens(bench: EmulatedBench) -> None:
        if case.moment == RUNNING:
            bench.await_state("playing", played=PLAYED)
            bench.processes["display"].send_signal(STEP)
        until((bench.folder / "raised").exists, WITHIN_S)
        # The state and the faults of the telemetry are what all screens show.
        fault = faults_of(bench.await_state("fault"))[0]
        raised_ns = int((bench.folder / "raised").read_text("utf-8"))
        if case.moment == RUNNING:
            assert fault.kind is FaultKind.INTERNAL
            assert case.error in fault.cause
            # A fault has the time at which its step began.
            assert abs(fault.at_ns - raised_ns) < SHOWN_WITHIN_NS
        else:
            assert fault.kind is not FaultKind.INTERNAL
            assert fault.at_ns <= raised_ns
        until(lambda: outcome_shown(bench) is WithdrawalOutcome.WITHDRAWN, WITHIN_S)
        bench.await_rest(withdrawn=True)
        assert end_display(bench) == FAULT_STATUS

    alteration = f"raise={case.method},{case.error},{case.moment},{{here}}/raised"
    before = ("--fault", FAULTS_BEFORE[case.kind], "--fault-after", "1")
    options = before if case.moment == WITHDRAWAL else ()
    motor = on_a_bench(tmp_path, case.kind, happens, *options, alteration=alteration).motor()
    assert motor.force_n.max() > 0.1
    assert motor.force_n[-1] == 0


@pytest.mark.parametrize("case", cases(HOMING))
def test_an_error_that_no_code_expects_ends_a_start_with_one_line(
    case: Case, tmp_path: Path
) -> None:
    skip_without_bus(case.kind)
    raised = tmp_path / "raised"
    printed = tmp_path / "printed"
    with printed.open("wb") as output:
        bench = EmulatedBench(tmp_path, case.kind, watchdog_ms=PATIENCE_MS, output=output.fileno())
        bench.alteration = f"raise={case.method},{case.error},{case.moment},{raised}"
        try:
            bench.start_drive()
            until(bench.film.exists, WITHIN_S)
            bench.start_display()
            status = bench.processes["display"].wait(WITHIN_S)
            assert raised.exists()
            bench.await_rest(withdrawn=True)
            bench.end()
        finally:
            bench.kill()
    text = printed.read_text("utf-8")
    assert status == FAULT_STATUS, text
    lines = [line for line in text.splitlines() if case.error in line]
    assert len(lines) == 1, text
    assert "Traceback" not in text
    assert bench.motor().force_n.max() < 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_an_end_withdraws_the_tip_and_has_the_status_of_no_fault(kind: str, tmp_path: Path) -> None:
    def happens(bench: EmulatedBench) -> None:
        bench.await_state("playing", played=PLAYED)
        assert end_display(bench) == 0
        bench.await_rest(withdrawn=True)

    assert on_a_bench(tmp_path, kind, happens).motor().force_n[-1] == 0


@pytest.mark.parametrize(
    ("kind", "method"), [("tmcl", f"{TMCL}.rotate"), ("cia402", f"{CIA402}.command")]
)
def test_an_end_that_may_leave_the_tip_pressed_is_a_fault_and_names_the_switch(
    kind: str, method: str, tmp_path: Path
) -> None:
    """The drive gets the velocity 0 once the run has ended."""

    def happens(bench: EmulatedBench) -> None:
        bench.await_state("playing", played=PLAYED)
        assert end_display(bench) == FAULT_STATUS
        said = [line for line in bench.log().splitlines() if "may still press" in line]
        assert len(said) == 1, bench.log()
        assert "switch the drive's power off" in said[0]

    on_a_bench(tmp_path, kind, happens, alteration=f"held={method}")
