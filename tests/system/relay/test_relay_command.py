"""`telepulse relay` between real nodes."""

import signal
from contextlib import ExitStack
from pathlib import Path
from subprocess import Popen

import pytest

from protocol.sockets import Context
from telepulse.cli.main import app
from tests.support.live_display import (
    PATIENCE_S,
    await_state,
    display_arguments,
    sensing_arguments,
    subscribe,
)
from tests.support.log_lines import unusual
from tests.support.nodes import assert_accounted, free_address, process, read_json

pytestmark = pytest.mark.usefixtures("goes_first")


def relay_arguments(connect: str, bind: str, *more: str) -> tuple[str, ...]:
    return ("relay", "--connect", connect, "--bind", bind, *more)


def test_two_relays_feed_a_display_each_and_every_sample_is_accounted_for(
    context: Context, tmp_path: Path
) -> None:
    address, *relays = (free_address() for _ in range(3))
    telemetry = [free_address() for _ in relays]
    screens = [subscribe(context, one) for one in telemetry]
    sensing_sum, *relay_sums = (tmp_path / f"{number}.json" for number in range(3))
    display_sums = [tmp_path / f"display{number}.json" for number in range(2)]
    with ExitStack() as stack:

        def start(module: str, *arguments: str) -> Popen[str]:
            return stack.enter_context(process(module, *arguments))

        # The second is behind the first.
        nodes = [
            start("telepulse", *relay_arguments(connect, bind, "--json", str(path)))
            for connect, bind, path in zip((address, relays[0]), relays, relay_sums, strict=True)
        ]
        displays = [
            start("display_node.cli", *display_arguments(*ends, "--once", "--json", str(path)))
            for *ends, path in zip(relays, telemetry, display_sums, strict=True)
        ]
        for screen in screens:
            await_state(screen, "waiting")
        arguments = (*sensing_arguments(address, 60), "--json", str(sensing_sum))
        sensing = start("sensing_node.cli", *arguments)
        for screen in screens:
            await_state(screen, "playing")
        sensing.send_signal(signal.SIGTERM)
        for node in (sensing, *displays):
            assert node.wait(PATIENCE_S) == 0
        for node, number in zip(nodes, (signal.SIGINT, signal.SIGTERM), strict=True):
            node.send_signal(number)
            _, errors = node.communicate(timeout=PATIENCE_S)
            # Both relays start before the sensing node.
            warnings = [line for line in unusual(errors).splitlines() if "is silent" not in line]
            assert (node.returncode, warnings) == (0, [])
            assert "frames" in errors
    relayed = [read_json(path)["frames"]["received"] for path in relay_sums]
    sent = read_json(sensing_sum)["samples"]["sent"]
    for path, frames in zip(display_sums, relayed, strict=True):
        summary = read_json(path)
        samples = summary["samples"]
        assert_accounted(samples)
        assert samples["sent"] + samples["before_joining"] == sent
        assert samples["played"] > 0
        assert samples["lost"] == 0
        assert summary["frames"]["received"] <= frames
    assert relayed[0] >= relayed[1]


@pytest.mark.parametrize(
    ("connect", "bind"),
    [
        ("tcp://192.0.2.1:5555", "tcp://127.0.0.1:5655"),
        ("tcp://127.0.0.1:5555", "tcp://*:5655"),
        ("wrist", "tcp://127.0.0.1:5655"),
        ("tcp://127.0.0.1:5555", "tcp://127.0.0.1:70000"),
    ],
)
def test_what_cannot_be_used_is_one_line(
    connect: str, bind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        app(relay_arguments(connect, bind), standalone_mode=False)
    assert ended.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert (connect if connect != "tcp://127.0.0.1:5555" else bind) in error
