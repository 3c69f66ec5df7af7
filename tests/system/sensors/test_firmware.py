"""The sketch of docs/firmware: compiled as C++ with an emulated board, and run by an AVR core."""

import shutil
import subprocess
from collections import Counter
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from protocol.config.scene import validate
from pulse_sensors.binary_frames import FrameDecoder
from pulse_sensors.samples import SampleBlock
from pulse_sensors.sensor import open_sensor
from pulse_sensors.serial_port import SerialScene
from tests.support.nodes import ROOT
from tests.support.sample_blocks import forces, received

SKETCH = ROOT / "docs" / "firmware" / "telepulse_sensor" / "telepulse_sensor.ino"
BOARD = """
#pragma once
#include <cstdint>
#include <cstdio>
#include <cstring>
const uint8_t A0 = 14;
uint32_t present_us = 0xFFFFFFFFu - 50000;
int readings = 0;
uint32_t micros() { return present_us += 37; }
int analogRead(uint8_t pin) { return pin == A0 ? (readings++ * 8) % 1024 : -1; }
struct {
  void begin(long) {}
  void write(const uint8_t *data, size_t n) { fwrite(data, 1, n, stdout); }
} Serial;
"""
MAIN = '#include "{sketch}"\nint main() {{ setup(); while (readings < 400) loop(); }}\n'


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_frames_of_the_sketch_are_decoded(tmp_path: Path) -> None:
    (tmp_path / "Arduino.h").write_text(BOARD, encoding="utf-8")
    main, program = tmp_path / "main.cpp", tmp_path / "board"
    main.write_text(MAIN.format(sketch=SKETCH), encoding="utf-8")
    command = ["g++", "-Wall", "-Wextra", "-Werror", f"-I{tmp_path}", str(main), "-o", str(program)]
    compiled = subprocess.run(command, capture_output=True, encoding="utf-8", check=False)
    assert compiled.returncode == 0, compiled.stderr
    sent = subprocess.run([str(program)], capture_output=True, check=True, timeout=20).stdout
    decoder = FrameDecoder(1_000_000)
    blocks = decoder.feed(sent)
    assert forces(blocks) == [i * 8 % 1024 for i in range(400)]
    assert [block.missing for block in blocks] == [0] * 100
    assert [block.restarted for block in blocks] == [True] + [False] * 99
    times_ns = np.array([block.device_ns for block in blocks if block.device_ns is not None])
    assert np.diff(times_ns) == pytest.approx(4_000_000, abs=40_000)
    assert not decoder.rejected


ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr")
SIMAVR = Path("/usr/include/simavr/sim_avr.h")
TRIES = 3
CORE = ("main", "HardwareSerial", "HardwareSerial0", "Print", "abi")
WIRING = ("wiring", "wiring_analog", "wiring_digital", "hooks")
CHIP = "-mmcu=atmega328p -DF_CPU=16000000L -DARDUINO=10819 -Os -ffunction-sections -fdata-sections"
BOARD_SOURCE = ROOT / "tests" / "support" / "avr" / "board.c"
# A resonator of 0.5 %, as on an Arduino Uno, may be off by this.
DRIFT_PPM = 2_000
PEAK_N = 0.2048
SAMPLES = 8_000


def missing() -> str | None:
    """Return what is missing to run the sketch on an AVR core; None where nothing is."""
    if all(map(shutil.which, ("avr-g++", "gcc"))) and ARDUINO.exists() and SIMAVR.exists():
        return None
    return (
        "needs gcc and, of Debian: gcc-avr, avr-libc, arduino-core-avr, libsimavr-dev, libelf-dev"
    )


def read_board(command: list[str]) -> tuple[list[SampleBlock], float, Counter[str]]:
    """Run the emulated board; return its samples, the skew of its clock, and what was refused."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, encoding="utf-8") as running:
        assert running.stdout is not None
        while not (line := running.stdout.readline().strip()).startswith("/dev/"):
            assert running.poll() is None
        table = {"kind": "serial", "port": line, "framing": "binary", "rate": "1 kHz"}
        table |= {"unit": "counts", "zero": 512, "newtons_per_count": 0.001}
        scene = validate(table, SerialScene, "scene")
        try:
            with closing(open_sensor(scene, Path())) as sensor:
                return received(sensor, SAMPLES), sensor.timestamper.clock.skew_ppm, sensor.rejected
        finally:
            running.kill()


@pytest.mark.skipif(missing() is not None, reason=str(missing()))
def test_the_sketch_on_an_atmega_streams_by_the_chips_own_clock(tmp_path: Path) -> None:
    core = ARDUINO / "cores" / "arduino"
    chip = [*CHIP.split(), f"-I{core}", f"-I{ARDUINO}/variants/standard"]
    sources = [str(core / f"{name}.cpp") for name in CORE]
    firmware, board = tmp_path / "sketch.elf", tmp_path / "board"
    for command in (
        ["avr-gcc", *chip, "-std=gnu11", "-c", *(str(core / f"{name}.c") for name in WIRING)],
        [
            *("avr-g++", *chip, "-std=gnu++17", "-fno-exceptions", "-x", "c++", str(SKETCH)),
            *(*sources, "-x", "none", *(f"{name}.o" for name in WIRING)),
            *("-Wl,--gc-sections", "-o", str(firmware)),
        ],
        ["gcc", "-O2", str(BOARD_SOURCE), "-o", str(board), "-lsimavr", "-lelf", "-lm", "-lutil"],
    ):
        made = subprocess.run(
            command, cwd=tmp_path, capture_output=True, encoding="utf-8", check=False
        )
        assert made.returncode == 0, made.stderr
    command = [str(board), str(firmware), str(DRIFT_PPM)]
    # Where the machine keeps the reader from its processor, the port overflows; a board that loses
    # samples does so each time.
    for _ in range(TRIES):
        blocks, skew_ppm, rejected = read_board(command)
        if not any(block.missing for block in blocks):
            break
    assert set(rejected) <= {"partial"}
    assert [block.missing for block in blocks] == [0] * len(blocks)
    force_n = np.array(forces(blocks))
    # The sine wave of 1 Hz at the input: its converter has steps of 1 mN here.
    period = np.exp(-2j * np.pi * np.arange(SAMPLES) / 1_000)
    assert 2 * abs(force_n[:SAMPLES] @ period) / SAMPLES == pytest.approx(PEAK_N, rel=0.01)
    assert force_n.mean() == pytest.approx(0, abs=0.002)
    # The host paces the chip, and is busy with other tests.
    assert skew_ppm == pytest.approx(DRIFT_PPM, rel=0.25)
