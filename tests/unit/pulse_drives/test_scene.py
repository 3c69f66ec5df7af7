from typing import Any

import pytest

from display_node.hardware import build_display_drive
from display_node.scene import DisplayScene
from protocol.config.scene import validate
from protocol.errors import SceneError
from tests.support.drive_benches import FORCE_LIMIT_N, LAYER
from tests.support.refusals import refusal_of

STEPPER = {"kind": "stepper"}
BOARD = {"kind": "stepdir", "port": "/dev/ttyACM0"}
SERIAL = {"kind": "tmcl", "port": "/dev/ttyACM0"}


def display(drive: dict[str, Any], actuator: dict[str, Any] = STEPPER) -> DisplayScene:
    table = {"controller": {"kp": 1}, "actuator": actuator, "drive": drive}
    return validate(table, DisplayScene, where="[display]")


@pytest.mark.parametrize(
    ("drive", "words"),
    [
        ({"kind": "dyadic"}, "unknown kind 'dyadic'"),
        ({"kind": "tmcl"}, "either port"),
        ({**SERIAL, "interface": "virtual", "channel": "x"}, "either port"),
        ({"kind": "tmcl", "interface": "virtual"}, "both interface and channel"),
        ({**SERIAL, "watchdog": "20 ms"}, "reply_timeout must be at most a quarter of watchdog"),
        ({**SERIAL, "period": "20 ms"}, "period must be at most a quarter of watchdog"),
        ({**SERIAL, "motor": 9}, "motor"),
        ({"kind": "cia402", "interface": "virtual"}, "channel: missing"),
        ({"kind": "cia402", "interface": "v", "channel": "c", "node": 127}, "node"),
        ({"kind": "stepdir"}, "port: missing"),
        ({**BOARD, "velocity_scale": 2.0}, 'velocity_scale is not for kind = "stepdir"'),
        ({**BOARD, "bitrate": "1 Mbit/s"}, 'bitrate is not for kind = "stepdir"'),
        ({**BOARD, "watchdog": "600 ms"}, "watchdog"),
        ({**BOARD, "baud": 115_200}, "baud"),
    ],
)
def test_an_invalid_table_is_refused_in_one_line(drive: dict[str, Any], words: str) -> None:
    assert words in refusal_of(SceneError, display, drive)


def test_only_a_drive_that_reads_a_film_can_be_its_sensor() -> None:
    film = {"kind": "drive", "newtons_per_count": 1e-3}
    table = {"controller": {"kp": 1}, "actuator": STEPPER, "feedback": film}
    scene = validate({**table, "drive": BOARD}, DisplayScene, where="[display]")
    assert scene.feedback is not None
    assert scene.feedback.rate_hz == 1000.0
    with pytest.raises(SceneError, match='a drive of kind "tmcl" reads no film'):
        validate({**table, "drive": SERIAL}, DisplayScene, where="[display]")
    film.pop("newtons_per_count")
    with pytest.raises(SceneError, match="newtons_per_count"):
        validate({**table, "drive": BOARD}, DisplayScene, where="[display]")


@pytest.mark.parametrize(
    ("actuator", "words"),
    [({"kind": "second_order"}, "stepper"), ({**STEPPER, "microsteps": 10}, "got 10")],
)
def test_an_actuator_that_the_drive_cannot_move_is_refused(
    actuator: dict[str, Any], words: str
) -> None:
    scene = display(SERIAL, actuator)
    assert scene.drive is not None
    with pytest.raises(SceneError, match=words):
        build_display_drive(scene.drive, scene.actuator, LAYER, FORCE_LIMIT_N)
