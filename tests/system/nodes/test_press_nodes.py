"""The press between real processes: kill, restart, and a hand on a press sensor."""

import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from protocol.sockets import Context
from protocol.wire import messages as wire
from tests.support.live_display import await_state, subscribe
from tests.support.log_lines import strays
from tests.support.nodes import ROOT, free_address, process, read_json
from tests.support.sensing_client import Client
from tests.support.waiting import until

pytestmark = pytest.mark.system
SCENE = str(ROOT / "scenes" / "press.toml")
SENSING, DISPLAY = "sensing_node.cli", "display_node.cli"
EASED_N = 0.26
# Of the scene, at the wrist.
SLEW_N_PER_S = 25.0
PATIENCE_S = 20.0


def display(address: str, telemetry: str = "tcp://127.0.0.1:*") -> tuple[str, ...]:
    return (DISPLAY, SCENE, "--connect", address, "--telemetry", telemetry, "--quiet")


def hold_down_of(message: bytes) -> float:
    """Return the mean hold-down of a frame."""
    values = wire.decode_frame(message).values
    return float(np.mean(values[:, 1] - values[:, 0]))


def newest_hold_down(client: Client) -> float:
    """Return the mean hold-down of the newest frame that has arrived, waiting for one."""
    messages = [client.data.recv()]
    while client.data.poll(0):
        messages.append(client.data.recv())
    return hold_down_of(messages[-1])


def await_hold_down(client: Client, low_n: float, high_n: float) -> None:
    """Wait until the hold-down is within two forces."""
    began_s = time.monotonic()
    while not low_n <= newest_hold_down(client) <= high_n:
        assert time.monotonic() - began_s < PATIENCE_S, "the hold-down did not get there"


def set_point(session: int, press: int, number: int, force_n: float) -> wire.SetPoint:
    return wire.SetPoint(session, press, number, time.perf_counter_ns(), 10**9, force_n)


def test_a_killed_display_leaves_the_wrist_free(address: str, client: Client) -> None:
    with process(SENSING, SCENE, "--bind", address) as wrist:
        session = client.join().session
        with process(*display(address)) as finger:
            await_hold_down(client, 0.5, 2.0)
            # Meanwhile nobody else may press.
            answer = client.ask(set_point(session, 1, 0, 3.0))
            assert isinstance(answer, wire.ProbeReport)
            assert answer.state == "held"
            finger.kill()
        # The bound of 0.5 s until it is eased off is proved in virtual time.
        await_hold_down(client, -0.1, 0.03)
        # Later another display may press.
        began_s = time.monotonic()
        while True:
            answer = client.ask(set_point(session, 2, 0, 0.5))
            assert isinstance(answer, wire.ProbeReport)
            if answer.state != "held":
                break
            assert time.monotonic() - began_s < PATIENCE_S
            time.sleep(0.1)
        wrist.terminate()
        _, log = wrist.communicate(timeout=30)
    assert log.count("refused a set-point: another display presses") == 1
    assert strays(log) == ""


def test_a_restarted_wrist_is_shown_and_pressed_again_by_a_ramp(
    address: str, client: Client, context: Context
) -> None:
    telemetry = free_address()
    reader = subscribe(context, telemetry)
    with process(*display(address, telemetry)):
        with process(SENSING, SCENE, "--bind", address, "--quiet") as wrist:
            await_hold_down(client, 0.5, 2.0)
            wrist.kill()
        await_state(reader, "stale")
        while client.data.poll(0):
            client.data.recv()
        hold_downs_n: list[float] = []
        with process(SENSING, SCENE, "--bind", address, "--quiet"):
            while not hold_downs_n or hold_downs_n[-1] < 0.5:
                hold_downs_n.append(hold_down_of(client.data.recv()))
            await_state(reader, "playing")
        assert hold_downs_n[0] < EASED_N
        # Over four frames of 5 ms; the ramp has a fifth of the slew limit.
        rises_n = np.array(hold_downs_n)[4:] - np.array(hold_downs_n)[:-4]
        assert rises_n.max() < 0.3 * SLEW_N_PER_S * 0.02


# The hand presses with these forces in turn, 3 s each.
LEVELS_N, EVERY_S, RATE_HZ = (0.8, 1.3), 3, 1_000

HAND = """
[sensing.source]
kind = "recording"
path = "hand.csv"
column = "press"
unit = "N"
rate = "1 kHz"
"""
SENSOR_SCENE = """
extends = "press"
[display.press.sensor]
kind = "serial"
port = "{folder}/hand"
framing = "binary"
rate = "1 kHz"
unit = "N"
"""


def test_a_hand_on_a_press_sensor_presses_the_wrist_and_its_silence_eases_off(
    address: str, tmp_path: Path
) -> None:
    levels = np.repeat(LEVELS_N, EVERY_S * RATE_HZ)
    rows = "".join(f"{force_n:.4f}\n" for force_n in levels)
    (tmp_path / "hand.csv").write_text(f"press\n{rows}", encoding="utf-8")
    (hand := tmp_path / "hand.toml").write_text(HAND, encoding="utf-8")
    (scene := tmp_path / "scene.toml").write_text(
        SENSOR_SCENE.format(folder=tmp_path), encoding="utf-8"
    )
    json, port = tmp_path / "finger.json", tmp_path / "hand"
    board = ("emulate", "sensor", str(hand), "--link", str(port), "--delivery-ms", "4")
    own = ("--telemetry", "tcp://127.0.0.1:*", "--json", str(json), "--quiet")
    with (
        process("sensing_node.cli", str(scene), "--bind", address, "--quiet"),
        closing(Client(address)) as client,
    ):
        client.join()
        with process("telepulse", *board) as sensor:
            until(port.exists)
            with process("display_node.cli", str(scene), "--connect", address, *own) as finger:
                for level_n in LEVELS_N:
                    await_hold_down(client, 0.95 * level_n, 1.05 * level_n)
                sensor.terminate()
                sensor.wait(30)
                # The bound of 0.5 s is proved in virtual time.
                await_hold_down(client, -0.1, EASED_N)
                with process("telepulse", *board):
                    await_hold_down(client, 0.95 * LEVELS_N[0], 1.05 * LEVELS_N[0])
                    finger.terminate()
                    finger.wait(30)
        await_hold_down(client, -0.1, EASED_N)
    press = read_json(json)["press"]
    assert press["sent"] == press["applied"] + press["superseded"] + press["lost"]
    assert press["applied"] > 20
