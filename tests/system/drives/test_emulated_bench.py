"""The whole emulated bench as processes: board, sensing node, display node, drive and film.

On a busy machine a watchdog may stop the bench; the assertions hold then, too. Times from a fault
to rest are in tests/unit/display_node/test_hardware.py, in virtual time.
"""

import signal
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

from protocol.cli_options import FAULT_STATUS
from protocol.faults import FaultKind, faults_of
from protocol.finger import describe_finger, finger_in
from tests.support.can_messages import udp_multicast_reason
from tests.support.emulated_bench import BenchFailedError, EmulatedBench, MotorTrace, playing
from tests.support.unread import unread
from tests.support.waiting import until
from tests.system.drives.attempts import PATIENCE_MS, on_bench

LIMIT_N = 2.5
PLAYED = 500
WITHDRAWN_WITHIN_S = 20.0
# Time from the first press until the ramp is over and the pulse is felt.
TROUBLE_AFTER_S = "1"


def on_a_bench(
    folder: Path,
    kind: str,
    happens: Callable[[EmulatedBench], None],
    *options: str,
    output: int | None = None,
) -> MotorTrace:
    """Return the motor's trace of a bench on which `happens` is called while the pulse is felt."""
    if kind == "cia402" and (reason := udp_multicast_reason()) is not None:
        pytest.skip(f"udp_multicast: {reason}")

    def started(here: Path) -> AbstractContextManager[EmulatedBench]:
        return playing(here, kind, "real_bench", *options, watchdog_ms=PATIENCE_MS, output=output)

    return on_bench(folder, started, happens).motor()


def assert_at_rest(motor: MotorTrace) -> None:
    """Assert that a force was felt, at most the limit, and that the motor is at rest at the end."""
    assert 0.1 < motor.force_n.max() <= LIMIT_N
    assert not motor.speed_m_per_s[-50:].any()


def test_a_terminated_display_withdraws_the_tip(tmp_path: Path) -> None:
    """Before that, the pulse is felt, its stream ends, and it is felt again.

    The display's output is not read, which must not block its start or the withdrawal.
    """
    silent_ns: list[int] = []

    def happens(bench: EmulatedBench) -> None:
        bench.await_state("playing", played=PLAYED)
        bench.processes["sensing"].kill()
        played = bench.await_state("stale")["samples"]["played"]
        bench.await_rest(withdrawn=True)
        silent_ns.append(time.perf_counter_ns())
        bench.start_sensing()
        bench.await_state("playing", played=played + PLAYED)
        summary = bench.end()
        # On a busy machine, the watchdog may have stopped the display before.
        if summary["faults"]:
            raise BenchFailedError(summary["faults"])
        assert summary["samples"]["played"] > 0
        assert summary["force_rmse_n"]["aligned"] < 0.1
        times = {name: limit["times"] for name, limit in summary["limited"].items()}
        # With so long a watchdog the drive brakes early, how often depends on the machine.
        assert times.pop("travel") is not None
        assert times == {"force": 0, "negative": 0, "slew": 0, "film": None, "adc": None}

    with unread("pipe") as output:
        motor = on_a_bench(tmp_path, "tmcl", happens, output=output)
    assert_at_rest(motor)
    assert motor.force_n[-1] == 0
    before = motor.time_ns < silent_ns[-1]
    assert motor.force_n[before][-1] == 0
    assert motor.force_n[~before].max() > 0.1


@pytest.mark.parametrize("kind", ["tmcl", "cia402", "stepdir"])
def test_a_display_that_was_stopped_withdraws_the_tip(kind: str, tmp_path: Path) -> None:
    """SIGSTOP lasts longer than the drive's watchdog; after SIGCONT the display withdraws."""
    withdrawn_ns: list[int] = []

    def happens(bench: EmulatedBench) -> None:
        bench.await_state("playing", played=PLAYED)
        display = bench.processes["display"]
        display.send_signal(signal.SIGSTOP)
        time.sleep(2e-3 * PATIENCE_MS)
        display.send_signal(signal.SIGCONT)
        until(lambda: finger_in(bench.await_state("fault")).withdrawn, WITHDRAWN_WITHIN_S)
        withdrawn_ns.append(time.perf_counter_ns())
        summary = bench.end()
        assert summary["samples"]["played"] > 0
        assert faults_of(summary)[0].kind is FaultKind.NO_COMMAND
        assert finger_in(summary).withdrawn

    motor = on_a_bench(tmp_path, kind, happens)
    assert_at_rest(motor)
    assert motor.force_n[motor.time_ns < withdrawn_ns[-1]][-1] == 0


def test_a_killed_display_leaves_the_motor_to_its_watchdog(tmp_path: Path) -> None:
    def happens(bench: EmulatedBench) -> None:
        bench.processes["display"].kill()
        bench.await_rest()

    assert_at_rest(on_a_bench(tmp_path, "tmcl", happens))


def test_a_board_whose_display_is_killed_takes_the_tip_off_the_finger(tmp_path: Path) -> None:
    def happens(bench: EmulatedBench) -> None:
        bench.processes["display"].kill()
        bench.await_rest(withdrawn=True)

    motor = on_a_bench(tmp_path, "stepdir", happens)
    assert_at_rest(motor)
    assert motor.force_n[-1] == 0


@pytest.mark.parametrize(
    ("kind", "word", "finger"),
    [
        ("tmcl", "film-silent", "force unknown since "),
        ("tmcl", "unplugged", "the drive does not answer"),
        ("stepdir", "unplugged", "the drive does not answer"),
        ("stepdir", "reset", "withdrawn"),
    ],
)
def test_a_bench_with_a_fault_rests_and_reports_it(
    kind: str, word: str, finger: str, tmp_path: Path
) -> None:

    def happens(bench: EmulatedBench) -> None:
        bench.await_state("fault")
        bench.await_rest(withdrawn=kind == "stepdir")
        summary = bench.end()
        assert summary["faults"]
        assert finger in describe_finger(finger_in(summary))
        assert bench.processes["display"].returncode == FAULT_STATUS

    options = ("--fault", word, "--fault-after", TROUBLE_AFTER_S)
    assert_at_rest(on_a_bench(tmp_path, kind, happens, *options))


def test_a_display_that_is_terminated_while_homing_leaves_the_drive_at_rest(tmp_path: Path) -> None:
    """SIGTERM comes before the loop starts, and before the drive's own watchdog is armed."""
    printed = tmp_path / "printed"
    with printed.open("wb") as output:
        bench = EmulatedBench(tmp_path, "tmcl", watchdog_ms=PATIENCE_MS, output=output.fileno())
        try:
            bench.start_drive()
            until((tmp_path / "film").exists)
            bench.start_display()
            until(lambda: b"looks for its home" in printed.read_bytes(), WITHDRAWN_WITHIN_S)
            bench.processes["display"].send_signal(signal.SIGTERM)
            assert bench.processes["display"].wait(WITHDRAWN_WITHIN_S) != 0
            bench.await_rest()
            bench.end()
        finally:
            bench.kill()
    assert not bench.motor().speed_m_per_s[-50:].any()
