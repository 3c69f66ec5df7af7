"""`telepulse relay` between real nodes."""

import signal
from contextlib import ExitStack
from pathlib import Path
from subprocess import Popen

import pytest

from protocol.sockets import Context
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


def test_two_relays_feed_a_display_each_and_every_sample_is_accounted_for(
    context: Context, tmp_path: Path
) -> None:
    address, *relays = (free_address() for _ in range(3))
    telemetry = [free_address() for _ in relays]
    screens = [subscribe(context, one) for one in telemetry]
    sensing_sum, *sums = (tmp_path / f"{number}.json" for number in range(5))
    with ExitStack() as stack:

        def start(module: str, *arguments: str, summary: Path) -> Popen[str]:
            return stack.enter_context(process(module, *arguments, "--json", str(summary)))

        # The second is behind the first.
        nodes = [
            start("telepulse", "relay", "--connect", connect, "--bind", bind, summary=summary)
            for connect, bind, summary in zip((address, relays[0]), relays, sums[:2], strict=True)
        ]
        displays = [
            start("display_node.cli", *display_arguments(*ends, "--once"), summary=summary)
            for *ends, summary in zip(relays, telemetry, sums[2:], strict=True)
        ]
        for screen in screens:
            await_state(screen, "waiting")
        sensing = start("sensing_node.cli", *sensing_arguments(address, 60), summary=sensing_sum)
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
    relayed = [read_json(path)["frames"]["received"] for path in sums[:2]]
    sent = read_json(sensing_sum)["samples"]["sent"]
    for path, frames in zip(sums[2:], relayed, strict=True):
        summary = read_json(path)
        samples = summary["samples"]
        assert_accounted(samples)
        assert samples["sent"] + samples["before_joining"] == sent
        assert samples["played"] > 0
        assert samples["lost"] == 0
        assert summary["frames"]["received"] <= frames
    assert relayed[0] >= relayed[1]
