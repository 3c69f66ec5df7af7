"""Strangers without a key, and low resource limits: a node continues, or does not start."""

import errno
import os
import signal
import socket as plain
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from subprocess import PIPE
from tempfile import TemporaryDirectory

import pytest
import zmq

from protocol import sockets
from protocol.host.child_process import ChildProcess
from protocol.sockets import Context
from protocol.wire.messages import Hello, encode_control
from tests.support.hostile_peers import port_of
from tests.support.keyring import Keyring
from tests.support.live_display import await_state, await_status
from tests.support.nodes import RADIAL, ROOT, free_address, read_json
from tests.support.rights import needs_rights
from tests.support.waiting import PATIENCE_S

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits and priorities are Linux's")
FEW_FILES = 128
STRANGERS = 300
NOBODY = 65_534
SENSING, DISPLAY = "sensing_node.cli", "display_node.cli"


def limited(limit: str, value: int, module: str, *arguments: str, umask: int = -1) -> ChildProcess:
    """Start a module with a scene under a resource limit, as `ulimit` sets it."""
    import resource

    return ChildProcess(
        module,
        *("-m", module, str(RADIAL), *arguments),
        cwd=ROOT,
        stdout=PIPE,
        stderr=PIPE,
        umask=umask,
        preexec_fn=lambda: resource.setrlimit(getattr(resource, limit), (value, value)),
    )


@contextmanager
def strangers(port: int) -> Iterator[None]:
    """Connect many times and send nothing."""
    with ExitStack() as until_the_end:
        for _ in range(STRANGERS):
            one = until_the_end.enter_context(plain.socket())
            one.setblocking(False)
            one.connect_ex(("127.0.0.1", port))
        yield


@needs_rights
def test_strangers_do_not_end_a_node_that_has_a_priority(
    context: Context, keyring: Keyring, tmp_path: Path
) -> None:
    address, telemetry = (free_address().replace("127.0.0.1", "*") for _ in range(2))
    here = [at.replace("*", "127.0.0.1") for at in (address, telemetry)]
    options = ("--realtime", "fifo=40", "--key", keyring.path("wrist"))
    played = tmp_path / "played.json"
    few = ("RLIMIT_NOFILE", FEW_FILES)
    shown = ("--no-screen", "--telemetry", telemetry, "--json", str(played))
    wanted = ("--connect", here[0], "--peer", keyring.path("wrist", "pub"), *shown)
    with (
        limited(*few, SENSING, "--bind", address, *options) as sensing,
        limited(*few, DISPLAY, *wanted, *options) as display,
    ):
        reader = sockets.connect(context, zmq.SUB, here[1], keyring.client("finger"))
        reader.subscribe(b"")
        reader.setsockopt(zmq.RCVTIMEO, 200)
        count = await_state(reader, "playing").summary["samples"]["played"]
        with strangers(port_of(here[0])), strangers(port_of(here[1])):
            # While the strangers are connected, and for 2 000 samples more.
            await_status(
                reader,
                lambda status: status.summary["rejected_readers"].get("too_many_connections"),
            )
            await_status(reader, lambda status: status.summary["samples"]["played"] > count + 2_000)
            asking = sockets.connect(
                context, zmq.DEALER, sockets.control_address(here[0]), keyring.client("finger")
            )
            asking.send(encode_control(Hello("late")))
            assert asking.poll(PATIENCE_S * 1000)
        for node in (display, sensing):
            node.send_signal(signal.SIGTERM)
            output, errors = node.communicate(timeout=PATIENCE_S)
            assert node.returncode == 0, output + errors
            assert "Traceback" not in output + errors
        assert read_json(played)["samples"]["played"] > 2_000


@pytest.mark.parametrize("module", [SENSING, DISPLAY])
@pytest.mark.parametrize(
    ("limit", "value", "advice"),
    [("RLIMIT_NOFILE", 14, "ulimit -n 4096"), ("RLIMIT_AS", 450 << 20, "ulimit -v unlimited")],
)
def test_a_node_does_not_start_below_its_resource_limits(
    module: str, limit: str, value: int, advice: str
) -> None:
    with limited(limit, value, module) as node:
        output, errors = node.communicate(timeout=PATIENCE_S)
    assert (node.returncode, output) == (2, "")
    assert errors.count("\n") == 1
    assert errors.rstrip().endswith(f"raise the limit: {advice}")


@needs_rights
def test_another_user_does_not_end_a_node_with_few_files_over_an_ipc_address() -> None:
    with TemporaryDirectory(prefix="telepulse-") as folder:
        Path(folder).chmod(0o755)
        path = Path(folder, "pulse")
        bind = ("--bind", f"ipc://{path}")
        with limited("RLIMIT_NOFILE", FEW_FILES, SENSING, *bind, umask=0) as node:
            node.read_line(PATIENCE_S, from_stderr=True)
            found: list[int] = []
            with ExitStack() as until_the_end:
                os.seteuid(NOBODY)
                until_the_end.callback(os.seteuid, 0)
                for _ in range(STRANGERS):
                    one = until_the_end.enter_context(plain.socket(plain.AF_UNIX))
                    one.setblocking(False)
                    found.append(one.connect_ex(str(path)))
                assert node.poll() is None
            assert set(found) == {errno.EACCES}
            # Its own user connects.
            with plain.socket(plain.AF_UNIX) as own:
                own.connect(str(path))
                own.settimeout(PATIENCE_S)
                assert own.recv(1)
            node.send_signal(signal.SIGTERM)
            output, errors = node.communicate(timeout=PATIENCE_S)
            assert node.returncode == 0, output + errors
