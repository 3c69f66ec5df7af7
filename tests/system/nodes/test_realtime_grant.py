import json
import os
import signal
import sys
from contextlib import closing
from typing import Any

import pytest
import zmq

from protocol.errors import RealtimeError
from protocol.host.process import FILES, helper_threads
from protocol.host.realtime import apply_realtime, parse_realtime
from tests.support.nodes import run_python
from tests.support.rights import needs_rights, without_rights

CHILD = "tests.support.realtime_child"
HANGS = """
import itertools
from protocol.host.realtime import apply_realtime, parse_realtime
with apply_realtime(parse_realtime("fifo=1")):
    print("held", flush=True)
    sum(itertools.repeat(0))
"""
FIFO, OTHER = os.SCHED_FIFO, [os.SCHED_OTHER, 0]
THERE = os.sched_getaffinity(0)


def measured(option: str, loop_s: float = 0, helper_s: float = 0, *, rights: bool = True) -> Any:
    run = run_python if rights else without_rights
    child = run("-m", CHILD, option, str(loop_s), str(helper_s))
    assert (child.returncode, child.stderr) == (0, "")
    return json.loads(child.stdout)


@needs_rights
def test_the_granted_settings_are_in_effect_and_all_are_undone() -> None:
    one = max(THERE)
    # A loop that pauses keeps its priority.
    found = measured(f"fifo=7,lock,cpu={one},slack", loop_s=0.05)
    assert found["refused"] == found["messages"] == []
    assert sorted(found["granted"]) == sorted(["fifo=7", "lock", f"cpu={one}", "slack"])
    held = found["held"]
    assert held["loop"] == found["later"]["loop"] == [FIFO, 7]
    # Threads of network and sensors have a priority below that of the loop.
    assert held["helpers"] == held["zeromq"] == [[FIFO, 6]]
    assert held["cpus"] == [one]
    # Threads that neither Python nor ZeroMQ has started get no priority.
    assert held["others"] == [OTHER]
    before = found["before"]
    assert held["helpers_cpus"] == before["cpus"]
    assert held["locked_kib"] > 1_000
    assert (before["loop"], before["locked_kib"]) == (OTHER, 0)
    assert found["after"] == before


def test_zeromqs_threads_are_found_before_they_have_a_name() -> None:
    for _ in range(50):
        before = helper_threads()
        with zmq.Context() as context, closing(context.socket(zmq.PUB)):
            # The reaper and the I/O thread.
            assert len(helper_threads() - before) == 2


@needs_rights
@pytest.mark.parametrize(("loop_s", "helper_s"), [(1.0, 0.0), (0.0, 0.6)], ids=["loop", "helper"])
def test_a_thread_that_runs_without_a_pause_loses_the_priority(
    loop_s: float, helper_s: float
) -> None:
    found = measured("slack,fifo=7", loop_s, helper_s)
    assert found["held"]["loop"] == [FIFO, 7]
    later = found["later"]
    assert later["loop"] == OTHER
    assert later["helpers"] == later["zeromq"] == [OTHER]
    assert found["granted"] == ["slack", "fifo=7 given up"]
    assert set(found["messages"]) == {"real-time: fifo is given up: 200 ms without a pause"}


@needs_rights
def test_a_process_that_handles_no_signal_is_ended_by_the_kernel() -> None:
    # Python handles no signal while a function of a library runs.
    child = run_python("-c", HANGS)
    assert (child.returncode, child.stdout) == (-signal.SIGKILL, "held\n")


def test_without_rights_each_refusal_is_explained_and_the_rest_is_granted() -> None:
    found = measured("fifo=7,lock,slack", rights=False)
    assert found["granted"] == ["slack"]
    lock, fifo = found["refused"]
    assert lock.startswith("real-time: lock is not granted: RLIMIT_MEMLOCK is 0 KiB")
    assert "memlock unlimited" in lock
    assert fifo.startswith("real-time: fifo=7 is not granted: RLIMIT_RTPRIO is 0; ")
    assert "rtprio 7" in fifo
    assert "\n" not in lock + fifo
    held = found["held"]
    assert held["loop"] == OTHER
    assert held["locked_kib"] == 0
    assert held["slack_ns"] == 1
    assert found["after"] == found["before"]


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


ELSEWHERE = """
import os, sys
for name in dir(os):
    if name.lower().startswith("sched_"):
        delattr(os, name)
import display_node.cli, protocol.host.process, sensing_node.cli
from display_node.doctor.host import describe, read_host
from protocol.host.realtime import apply_realtime, parse_realtime
sys.platform = "win32"
del protocol.host.process.resource
sys.modules["resource"] = None
with apply_realtime(parse_realtime("fifo,lock,cpu=0,slack")) as held:
    print(*held.granted)
print(*(refusal.name for refusal in held.refused))
print(*{refusal.reason for refusal in held.refused})
print(dict(describe(read_host()))["may run on"])
"""


def test_each_setting_is_refused_on_other_systems_than_linux() -> None:
    child = run_python("-c", ELSEWHERE)
    lines = ("", "lock slack cpu=0 fifo=40", "this system does not have it", "any")
    assert (child.stderr, tuple(child.stdout.splitlines())) == ("", lines)


PROGRAM = """
import resource
from protocol.host.process import raise_file_limit
resource.setrlimit(resource.RLIMIT_NOFILE, ({present}, {most}))
raise_file_limit()
print(*resource.getrlimit(resource.RLIMIT_NOFILE))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="there is no such limit")
@pytest.mark.parametrize(
    ("present", "most", "then"), [(128, 10_000, FILES), (128, 256, 256), (9_000, 10_000, 9_000)]
)
def test_the_limit_of_open_files_is_raised_as_far_as_permitted(
    present: int, most: int, then: int
) -> None:
    result = run_python("-c", PROGRAM.format(present=present, most=most))
    assert result.stdout.split() == [str(then), str(most)]
