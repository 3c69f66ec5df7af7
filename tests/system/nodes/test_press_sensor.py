"""A real press sensor under the finger: an emulated board that reads a hand, between processes."""

from contextlib import closing
from pathlib import Path

import numpy as np

from tests.support.nodes import process, read_json
from tests.support.sensing_client import Client
from tests.support.waiting import until
from tests.system.nodes.test_press_nodes import await_hold_down

# The hand presses with these forces in turn, 3 s each.
LEVELS_N, EVERY_S, RATE_HZ = (0.8, 1.3), 3, 1_000
EASED_N = 0.26

HAND = """
[sensing.source]
kind = "recording"
path = "hand.csv"
column = "press"
unit = "N"
rate = "1 kHz"
"""
SCENE = """
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
    (scene := tmp_path / "scene.toml").write_text(SCENE.format(folder=tmp_path), encoding="utf-8")
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
