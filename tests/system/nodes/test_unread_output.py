"""Processes whose output nobody reads: they serve, end at a signal, and write their summary."""

import fcntl
import os
import signal
import sys
import termios
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest

from protocol.host.child_process import ChildProcess
from protocol.sockets import Context
from tests.support.live_display import await_state, subscribe
from tests.support.nodes import RADIAL, ROOT, assert_accounted, free_address, process, read_json
from tests.support.unread import obeys_sigterm, process_into, unread
from tests.support.waiting import until

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="/dev/full, /proc")
ENDS_WITHIN_S = 60.0
SENSING, DISPLAY, TELEPULSE = "sensing_node.cli", "display_node.cli", "telepulse"


@contextmanager
def started(kind: str, module: str, *arguments: str) -> Iterator[ChildProcess]:
    with unread(kind) as number, process_into(number, module, *arguments) as child:
        yield child


def test_a_display_whose_output_is_not_read_plays_and_ends(
    context: Context, tmp_path: Path, address: str
) -> None:
    with ExitStack() as stack:
        stack.enter_context(process(SENSING, str(RADIAL), "--bind", address, "--quiet"))
        nodes = []
        for kind in ("terminal", "pipe"):
            telemetry, json = free_address(), tmp_path / f"{kind}.json"
            arguments = ("--connect", address, "--telemetry", telemetry, "--json", str(json))
            # The processes beside the node print as well: the screen; recorder and metrics.
            if kind == "pipe":
                recording = str(tmp_path / "all.mcap")
                arguments += ("--no-screen", "--record", recording, "--metrics", "0")
            reader = subscribe(context, telemetry)
            node = stack.enter_context(started(kind, DISPLAY, str(RADIAL), *arguments))
            nodes.append((node, reader, json))
        for node, reader, _ in nodes:
            await_state(reader, "playing")
            node.send_signal(signal.SIGTERM)
        for node, _, json in nodes:
            assert node.wait(ENDS_WITHIN_S) == 0, node.args
            samples = read_json(json)["samples"]
            assert_accounted(samples)
            assert samples["played"] > 0


def test_a_node_whose_terminal_closes_ends_as_at_ctrl_c(tmp_path: Path) -> None:
    master, terminal = os.openpty()
    json = tmp_path / "sum.json"
    command = ("-m", SENSING, str(RADIAL), "--bind", free_address(), "--json", str(json))
    options: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), terminal)

    def own_terminal() -> None:
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)
        # Under nohup the tests have it ignored, and so would the node.
        signal.signal(signal.SIGHUP, signal.SIG_DFL)

    options["preexec_fn"] = own_terminal
    with ChildProcess("sensing node", *command, cwd=ROOT, **options) as node:
        os.close(terminal)
        until(lambda: obeys_sigterm(node))
        os.close(master)
        assert node.wait(ENDS_WITHIN_S) == 0
        assert read_json(json)["samples"]["sent"] >= 0
