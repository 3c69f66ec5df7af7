import json
import os
import re
import signal
from pathlib import Path

import pytest

from protocol.errors import RealtimeError
from protocol.host.realtime import apply_realtime, parse_realtime
from protocol.sockets import Context
from tests.support.live_display import (
    MODULE,
    PATIENCE_S,
    await_state,
    display_arguments,
    sensing_arguments,
    subscribe,
)
from tests.support.log_lines import messages, strays, unusual
from tests.support.nodes import (
    RADIAL,
    assert_accounted,
    free_address,
    process,
    read_json,
    run_python,
)
from tests.support.rights import needs_rights, without_rights

REQUEST = "fifo=7,lock,slack"
NO_PRIORITY = "real-time: fifo=7 is not granted: RLIMIT_RTPRIO is 0; put"


def schedules(process: int) -> dict[int, tuple[int, int]]:
    """Return policy and priority of each thread of a process."""
    return {
        number: (os.sched_getscheduler(number), os.sched_getparam(number).sched_priority)
        for number in map(int, os.listdir(f"/proc/{process}/task"))
    }


def locked_kib(process: int) -> int:
    lines = Path(f"/proc/{process}/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmLck"))


@needs_rights
def test_granted_settings_are_in_effect_in_both_nodes_while_they_play(
    context: Context, tmp_path: Path
) -> None:
    address, telemetry_address = free_address(), free_address()
    telemetry = subscribe(context, telemetry_address)
    one = max(os.sched_getaffinity(0))
    summaries = [tmp_path / "sensing.json", tmp_path / "display.json"]
    own = [("--json", str(path), "--realtime") for path in summaries]
    playing = display_arguments(address, telemetry_address, "--screen", *own[1])
    with (
        process("sensing_node.cli", *sensing_arguments(address, 60), *own[0], REQUEST) as wrist,
        process(MODULE, *playing, f"{REQUEST},cpu={one}") as display,
    ):
        await_state(telemetry, "playing")
        for node in (wrist, display):
            found = schedules(node.pid)
            assert found[node.pid] == (os.SCHED_FIFO, 7)
            # ZeroMQ's I/O and reaper.
            assert list(found.values()).count((os.SCHED_FIFO, 6)) >= 2
            assert locked_kib(node.pid) > 1_000
        assert os.sched_getaffinity(display.pid) == {one}
        # The process that draws has none of these settings.
        children = Path(f"/proc/{display.pid}/task/{display.pid}/children").read_text(
            encoding="utf-8"
        )
        (screen,) = map(int, children.split())
        assert set(schedules(screen).values()) == {(os.SCHED_OTHER, 0)}
        assert os.sched_getaffinity(screen) == os.sched_getaffinity(0)
        display.send_signal(signal.SIGTERM)
        _, errors = display.communicate(timeout=PATIENCE_S)
        assert (display.returncode, unusual(errors)) == (0, "")
        wrist.send_signal(signal.SIGTERM)
        assert wrist.wait(PATIENCE_S) == 0
    assert len(re.findall(" real-time: lock .*, slack .*, fifo=7 .*$", errors, re.M)) == 1
    sensed, played = map(read_json, summaries)
    assert_accounted(played["samples"])
    assert sorted(sensed["loop"]["realtime"]) == sorted(REQUEST.split(","))
    assert sorted(played["loop"]["realtime"]) == sorted([*REQUEST.split(","), f"cpu={one}"])
    late_us = played["loop"]["late_us"]
    assert 0 < late_us["p50"] <= late_us["p99"] <= late_us["p999"] <= late_us["max"]


COLLECTIONS = """
import atexit, gc, runpy, sys
examined = []
def look(phase, info):
    if phase == "start" and info["generation"] == 2 and gc.get_freeze_count():
        examined.append(len(gc.get_objects()))
gc.callbacks.append(look)
def full():
    gc.collect()
    print(gc.get_freeze_count(), max(examined), file=sys.stderr)
atexit.register(full)
runpy.run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
"""


def test_each_refused_setting_is_a_line_and_a_full_collection_skips_old_objects(
    tmp_path: Path,
) -> None:
    """A collection stopped a sensing node for 20 to 30 ms soon after a display had joined."""
    summary = tmp_path / "summary.json"
    node = without_rights(
        *("-c", COLLECTIONS, "sensing_node.cli", str(RADIAL), "--bind", free_address(), "--quiet"),
        *("--seconds", "0.2", "--json", str(summary), "--realtime", REQUEST),
    )
    assert node.returncode == 0
    refusals = [line.partition(" is not granted: ")[0] for line in messages(node.stderr)]
    assert refusals == ["real-time: lock", "real-time: fifo=7"]
    assert read_json(summary)["loop"]["realtime"] == ["slack"]
    frozen, examined = map(int, strays(node.stderr).split())
    assert frozen > 10_000
    assert examined < frozen / 5


def test_a_node_whose_strict_request_is_refused_does_not_start() -> None:
    node = without_rights("-m", MODULE, str(RADIAL), "--realtime", "fifo=7,strict")
    assert (node.returncode, node.stdout, node.stderr.count("\n")) == (2, "", 1)
    assert node.stderr.startswith(f"display-node: {NO_PRIORITY}")


HANGS = """
import itertools
from protocol.host.realtime import apply_realtime, parse_realtime
with apply_realtime(parse_realtime("fifo=1")):
    print("held", flush=True)
    sum(itertools.repeat(0))
"""
# Prints the policies of its threads before and after a second without a pause.
SPINS = """
import json, os, time, zmq
from contextlib import closing
from protocol.host.realtime import apply_realtime, parse_realtime

def policies():
    return [os.sched_getscheduler(int(number)) for number in os.listdir("/proc/self/task")]

with zmq.Context() as context, closing(context.socket(zmq.PUB)):
    time.sleep(0.05)  # its threads have their names then
    with apply_realtime(parse_realtime("slack,fifo=7")) as held:
        before, end_s = policies(), time.monotonic() + 1.0
        while time.monotonic() < end_s:
            pass
        print(json.dumps([before, policies(), list(held.granted)]))
"""
THERE = os.sched_getaffinity(0)


@needs_rights
def test_a_thread_that_runs_without_a_pause_loses_the_priority() -> None:
    child = run_python("-c", SPINS)
    assert child.returncode == 0
    before, later, granted = json.loads(child.stdout)
    # The loop, and ZeroMQ's I/O and reaper.
    assert before.count(os.SCHED_FIFO) == 3
    assert set(later) == {os.SCHED_OTHER}
    assert granted == ["slack", "fifo=7 given up"]
    assert child.stderr == "real-time: fifo is given up: 200 ms without a pause\n"


@needs_rights
def test_a_process_that_handles_no_signal_is_ended_by_the_kernel() -> None:
    # Python handles no signal while a function of a library runs.
    child = run_python("-c", HANGS)
    assert (child.returncode, child.stdout) == (-signal.SIGKILL, "held\n")


@pytest.mark.parametrize("option", ["cpu=4000", f"cpu={max(THERE)},cpu=4000"])
def test_a_processor_that_does_not_exist_is_refused(option: str) -> None:
    with apply_realtime(parse_realtime(option)) as held:
        assert held.granted == {}
        assert os.sched_getaffinity(0) == THERE
    (refusal,) = held.refused
    assert "this process may use" in str(refusal)
    with (
        pytest.raises(RealtimeError, match=r"cpu=.*4000 is not granted"),
        apply_realtime(parse_realtime(f"slack,{option},strict")),
    ):
        pytest.fail("the settings are in effect")
    assert os.sched_getaffinity(0) == THERE
