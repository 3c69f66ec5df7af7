import os
import re
import signal
from pathlib import Path

import pytest

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

WISH = "fifo=7,lock,slack"


def priorities(process_id: int) -> dict[int, tuple[int, int]]:
    """Policy and priority of each thread of a process."""
    threads = [int(path.name) for path in Path(f"/proc/{process_id}/task").iterdir()]
    return {
        number: (os.sched_getscheduler(number), os.sched_getparam(number).sched_priority)
        for number in threads
    }


def locked_kib(process_id: int) -> int:
    status = Path(f"/proc/{process_id}/status").read_text(encoding="utf-8")
    found = re.search(r"VmLck:\s+(\d+)", status)
    assert found is not None
    return int(found[1])


def children(process_id: int) -> list[int]:
    path = Path(f"/proc/{process_id}/task/{process_id}/children")
    return [int(word) for word in path.read_text(encoding="ascii").split()]


@needs_rights
def test_both_nodes_hold_what_was_granted_and_play_on(context: Context, tmp_path: Path) -> None:
    address, telemetry_address = free_address(), free_address()
    telemetry = subscribe(context, telemetry_address)
    one = max(os.sched_getaffinity(0))
    arguments = list(
        display_arguments(address, telemetry_address, "--json", str(tmp_path / "display.json"))
    )
    arguments.remove("--no-screen")
    sensing = (*sensing_arguments(address, 60), "--json", str(tmp_path / "sensing.json"))
    with (
        process("sensing_node.cli", *sensing, "--realtime", WISH) as wrist,
        process(MODULE, *arguments, "--realtime", f"{WISH},cpu={one}") as display,
    ):
        await_state(telemetry, "playing")
        for node in (wrist, display):
            found = priorities(node.pid)
            assert found[node.pid] == (os.SCHED_FIFO, 7)
            # ZeroMQ's I/O and reaper.
            assert list(found.values()).count((os.SCHED_FIFO, 6)) >= 2
            assert locked_kib(node.pid) > 1_000
        assert os.sched_getaffinity(display.pid) == {one}
        # What draws has none of it.
        (screen,) = children(display.pid)
        assert set(priorities(screen).values()) == {(os.SCHED_OTHER, 0)}
        assert os.sched_getaffinity(screen) == os.sched_getaffinity(0)
        display.send_signal(signal.SIGTERM)
        _, errors = display.communicate(timeout=PATIENCE_S)
        assert (display.returncode, unusual(errors)) == (0, "")
        wrist.send_signal(signal.SIGTERM)
        assert wrist.wait(PATIENCE_S) == 0
    assert len(re.findall(" real-time: lock .*, slack .*, fifo=7 .*$", errors, re.M)) == 1
    summary = read_json(tmp_path / "display.json")
    assert_accounted(summary["samples"])
    assert sorted(summary["loop"]["realtime"]) == sorted([*WISH.split(","), f"cpu={one}"])
    late_us = summary["loop"]["late_us"]
    assert 0 < late_us["p50"] <= late_us["p99"] <= late_us["p999"] <= late_us["max"]
    assert sorted(read_json(tmp_path / "sensing.json")["loop"]["realtime"]) == sorted(
        WISH.split(",")
    )


@pytest.mark.parametrize(
    ("module", "option"), [(MODULE, "--connect"), ("sensing_node.cli", "--bind")]
)
def test_what_is_not_granted_is_a_line_each_and_the_node_runs(
    module: str, option: str, tmp_path: Path
) -> None:
    summary = tmp_path / "summary.json"
    node = without_rights(
        *("-m", module, str(RADIAL), option, free_address(), "--quiet"),
        *("--seconds", "0.2", "--json", str(summary), "--realtime", WISH),
    )
    assert node.returncode == 0
    lines = messages(node.stderr)
    starts = [f"real-time: {name} is not granted: " for name in ("lock", "fifo=7")]
    assert len(lines) == len(starts)
    assert all(line.startswith(start) for line, start in zip(lines, starts, strict=True))
    assert read_json(summary)["loop"]["realtime"] == ["slack"]


COLLECTIONS = """
import atexit, gc, runpy, sys
looked_at = []
def look(phase, info):
    if phase == "start" and info["generation"] == 2 and gc.get_freeze_count():
        looked_at.append(len(gc.get_objects()))
gc.callbacks.append(look)
def full():
    gc.collect()
    print(gc.get_freeze_count(), max(looked_at), file=sys.stderr)
atexit.register(full)
runpy.run_module(sys.argv.pop(1), run_name="__main__", alter_sys=True)
"""


@pytest.mark.parametrize(
    ("module", "option"), [(MODULE, "--connect"), ("sensing_node.cli", "--bind")]
)
def test_a_full_collection_leaves_alone_what_was_there_before_the_loop(
    module: str, option: str
) -> None:
    """It stopped a sensing node for 20 to 30 ms soon after a display had joined."""
    node = without_rights(
        *("-c", COLLECTIONS, module, str(RADIAL), option, free_address(), "--seconds", "0.2")
    )
    assert node.returncode == 0
    frozen, looked_at = map(int, strays(node.stderr).split())
    assert frozen > 10_000
    assert looked_at < frozen / 5


@pytest.mark.parametrize("module", [MODULE, "sensing_node.cli"])
def test_a_node_does_not_start_when_a_strict_request_is_refused(module: str) -> None:
    node = without_rights("-m", module, str(RADIAL), "--realtime", "fifo=7,strict")
    assert (node.returncode, node.stdout, node.stderr.count("\n")) == (2, "", 1)
    assert "real-time: fifo=7 is not granted: RLIMIT_RTPRIO is 0; put" in node.stderr


def test_a_misspelt_measure_is_refused_in_one_line() -> None:
    node = run_python("-m", MODULE, str(RADIAL), "--realtime", "lok")
    text = "display-node: --realtime: unknown measure 'lok'; did you mean lock?\n"
    assert (node.returncode, node.stderr) == (2, text)
