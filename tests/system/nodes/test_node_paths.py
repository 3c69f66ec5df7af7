"""The real nodes with several connections, and with several addresses."""

from pathlib import Path

from protocol.sockets import Context
from telepulse.processes import free_addresses
from tests.support.live_display import (
    MODULE,
    PATIENCE_S,
    await_status,
    display_arguments,
    sensing_arguments,
    subscribe,
)
from tests.support.nodes import RADIAL, assert_accounted, free_address, process, read_json


def test_with_three_paths_the_first_copy_of_each_frame_is_played(tmp_path: Path) -> None:
    scene, summary, address = tmp_path / "paths.toml", tmp_path / "out.json", free_address()
    text = RADIAL.read_text(encoding="utf-8")
    scene.write_text(text.replace("[display]\n", "[display]\npaths = 3\n"), encoding="utf-8")
    arguments = (str(scene), "--connect", address, "--json", str(summary), "--once")
    with (
        process(MODULE, *arguments, "--no-screen", "--seconds", "30") as display,
        process("sensing_node.cli", *sensing_arguments(address, 3)),
    ):
        assert display.wait(PATIENCE_S + 10) == 0
    result = read_json(summary)
    assert_accounted(result["samples"])
    assert result["samples"]["lost"] == 0
    # The three paths may have been connected at slightly different times.
    assert 1.5 < result["frames"]["copies"] / result["frames"]["received"] <= 2
    assert result["rejected"] == {}


def test_the_loss_of_one_of_two_addresses_loses_no_sample(context: Context, tmp_path: Path) -> None:
    address, relayed, telemetry_address = free_addresses(3)
    summary, telemetry = tmp_path / "out.json", subscribe(context, telemetry_address)
    # Control starts on the first address, that of the relay, which is killed.
    more = ("--connect", address, "--once", "--json", str(summary))
    relay_arguments = ("link", "--connect", address, "--bind", relayed, "--seconds", "60")
    with (
        process("telepulse", *relay_arguments) as relay,
        process(MODULE, *display_arguments(relayed, telemetry_address, *more)) as display,
        process("sensing_node.cli", *sensing_arguments(address, 10)),
    ):
        await_status(telemetry, lambda status: status.summary["frames"]["copies"] >= 50)
        relay.kill()
        assert display.wait(PATIENCE_S + 10) == 0
    result = read_json(summary)
    assert_accounted(result["samples"])
    # The end of the stream came over the other address.
    assert result["samples"]["sent"] + result["samples"]["before_joining"] == 10_000
    assert result["samples"]["lost"] == 0
    assert set(result["frames"]["first"]) == {relayed, address}
    assert sum(result["frames"]["first"].values()) == result["frames"]["received"]
    assert result["rejected"] == {}
