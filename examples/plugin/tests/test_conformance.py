"""The plug-in's own tests: each kind keeps to its interface, and is found by telepulse."""

import pytest
from telepulse_example.board import BoardScene
from telepulse_example.damped import DampedScene
from telepulse_example.sine import SineScene
from telepulse_example.stage import STAGES, StageScene
from telepulse_example.voice_coil import VoiceCoilScene

from telepulse.plugins import Section
from telepulse.testing import (
    check_actuator,
    check_drive,
    check_entry_point,
    check_predictor,
    check_sensor,
    check_source,
)


@pytest.mark.parametrize(
    "section", [SineScene, BoardScene, StageScene, VoiceCoilScene, DampedScene]
)
def test_telepulse_finds_each_kind(section: type[Section]) -> None:
    """The entry points in pyproject.toml name the section models."""
    check_entry_point(section)


def test_the_source_conforms() -> None:
    """Also with keys that are not the defaults."""
    check_source(SineScene, {"kind": "sine"})
    check_source(SineScene, {"kind": "sine", "rate": "500 Hz", "frequency": "7 Hz"})


def test_the_sensor_conforms() -> None:
    """The board is read for a second."""
    check_sensor(BoardScene, {"kind": "sine_board", "rate": "1 kHz", "unit": "N"}, seconds=1.0)


def test_the_actuator_conforms() -> None:
    """The controller relies on the model's `drift` and `response`."""
    check_actuator(VoiceCoilScene, {"kind": "voice_coil", "time_constant": "3 ms"})


def test_the_predictor_conforms() -> None:
    """It does not look ahead."""
    check_predictor(DampedScene, {"kind": "damped", "fades": "10 ms"})


def test_the_drive_conforms() -> None:
    """The stage itself says where the tip is."""
    keys = {"kind": "stage", "name": "conformance", "watchdog": "300 ms"}
    check_drive(StageScene, keys, lambda: STAGES["conformance"].position_m)
