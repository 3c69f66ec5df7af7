import os
import time
from pathlib import Path

import pytest

from display_node.doctor.jitter import Ticks, run_ticks
from tests.support.live_display import MODULE, PATIENCE_S
from tests.support.nodes import RADIAL, process, read_json, run_python
from tests.support.rights import needs_rights, without_rights
from tests.support.waiting import until

QUICK = ("-m", MODULE, "--doctor", "--seconds", "0.4")


def test_late_and_missed_ticks_are_counted_separately(monkeypatch: pytest.MonkeyPatch) -> None:
    now_ns = 0
    waits_ns = iter([1_000_000, 1_000_000, 3_400_000, 9_600_000])
    worked: list[tuple[int, int]] = []

    def wait(descriptors: object, timeout_ns: int) -> None:
        nonlocal now_ns
        now_ns += next(waits_ns)

    monkeypatch.setattr("display_node.doctor.jitter.sockets.wait_on_descriptors", wait)
    monkeypatch.setattr("display_node.doctor.jitter.time.perf_counter_ns", lambda: now_ns)
    ticks = Ticks()
    run_ticks(ticks, 1_000_000, 0.0055, [], lambda due_ns, n: worked.append((due_ns, n)))
    # The third began 2.4 ms late, when the next two were due; the last 9 ms late, after the end.
    assert worked == [(1_000_000, 1), (2_000_000, 1), (5_000_000, 3), (15_000_000, 10)]
    assert (ticks.missed, ticks.due) == (11, 15)
    assert ticks.late_us.maximum == 9_000.0


@needs_rights
def test_the_doctor_measures_ticks_with_each_setting_and_without(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    doctor = run_python(*QUICK, "--json", str(path), str(RADIAL))
    assert (doctor.returncode, doctor.stderr) == (0, "")
    report = read_json(path)
    assert report["refused"] == []
    assert {"slack", "lock", "fifo=40"} <= set(report["granted"])
    rows = {(row["with"], row["beside"]) for row in report["late_us"]}
    settings = {"bare", "together", *report["granted"]}
    assert rows == {(name, beside) for name in settings for beside in ("nothing", "load")}
    assert all(row["ticks"] > 0 for row in report["late_us"])
    assert report["verdict"]["status"] in ("ok", "warn", "fail")
    assert report["tick_ms"] == 2.0
    assert report["host"]["cpus"] == sorted(os.sched_getaffinity(0))
    assert f"{report['verdict']['status']}: {report['verdict']['reason']}" in doctor.stdout
    assert "fifo=40" in doctor.stdout


def test_a_refused_setting_is_named_with_advice(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    doctor = without_rights(*QUICK, "--json", str(path))
    assert (doctor.returncode, doctor.stderr) == (0, "")
    report = read_json(path)
    assert {refusal["name"] for refusal in report["refused"]} == {"lock", "fifo=40"}
    assert not {"lock", "fifo=40"} & {row["with"] for row in report["late_us"]}
    assert 'put "USER - rtprio 40" into' in doctor.stdout
    assert 'put "USER - memlock unlimited" into' in doctor.stdout


def test_a_killed_doctor_leaves_no_busy_processes() -> None:
    with process(MODULE, "--doctor", "--seconds", "20", "--quiet") as doctor:
        children = Path(f"/proc/{doctor.pid}/task/{doctor.pid}/children")
        while not (found := children.read_text(encoding="ascii").split()):
            assert doctor.poll() is None
            time.sleep(0.01)
        doctor.kill()
        doctor.wait(PATIENCE_S)
        until(lambda: not any(map(computes, found)))


def computes(process_id: str) -> bool:
    """Return whether the process runs; one that has ended may wait for its parent as a zombie."""
    try:
        status = Path(f"/proc/{process_id}/status").read_text(encoding="utf-8")
    except OSError:
        return False
    return "State:\tZ" not in status
