"""The wrist's sketch of firmware/: compiled as C++ with an emulated board, and run on an ATmega."""

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
from telepulse.emulators import sketch
from tests.support import simavr
from tests.support.sample_blocks import forces, received

SKETCH = sketch.FIRMWARE / "telepulse_sensor" / "telepulse_sensor.ino"
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


def frames_of_sketch(folder: Path, source: str) -> bytes:
    """Compile a sketch's text for this machine with an emulated board, and return its output."""
    (folder / "Arduino.h").write_text(BOARD, encoding="utf-8")
    copy, main, program = folder / "sketch.ino", folder / "main.cpp", folder / "board"
    copy.write_text(source, encoding="utf-8")
    main.write_text(MAIN.format(sketch=copy), encoding="utf-8")
    paths = [f"-I{folder}", f"-I{SKETCH.parent}"]
    sketch.run_compiler(folder, "g++", *simavr.WARNINGS, *paths, str(main), "-o", str(program))
    return subprocess.run([str(program)], capture_output=True, check=True, timeout=20).stdout


def test_both_sketches_have_the_same_framing() -> None:
    # Each folder opens in Arduino's editor as it is, without a library to install.
    files = [
        sketch.FIRMWARE / name / "telepulse_frames.h"
        for name in ("telepulse_display", "telepulse_sensor")
    ]
    assert len({file.read_bytes() for file in files}) == 1


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_frames_of_the_sketch_are_decoded(tmp_path: Path) -> None:
    decoder = FrameDecoder(1_000_000)
    blocks = decoder.feed(frames_of_sketch(tmp_path, SKETCH.read_text(encoding="utf-8")))
    assert forces(blocks) == [i * 8 % 1024 for i in range(400)]
    assert [block.missing for block in blocks] == [0] * 100
    assert [block.restarted for block in blocks] == [True] + [False] * 99
    times_ns = np.array([block.device_ns for block in blocks if block.device_ns is not None])
    assert np.diff(times_ns) == pytest.approx(4_000_000, abs=40_000)
    assert not decoder.rejected


@pytest.mark.skipif(shutil.which("g++") is None, reason="needs g++")
def test_three_films_and_an_ecg_are_samples_of_four_values(tmp_path: Path) -> None:
    source = SKETCH.read_text(encoding="utf-8").replace("{A0}", "{A0, A0, A0, A0}")
    decoder = FrameDecoder(1_000_000, channels=4)
    blocks = decoder.feed(frames_of_sketch(tmp_path, source.replace("115200", "500000")))
    values = np.concatenate([block.values for block in blocks])
    assert values.tolist() == (np.arange(400).reshape(100, 4) * 8 % 1024).tolist()
    assert not decoder.rejected


TRIES = 3
# A resonator of 0.5 %, as on an Arduino Uno, may be off by this.
DRIFT_PPM = 2_000
PEAK_N = 0.2048
SAMPLES = 8_000


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


@pytest.mark.skipif(simavr.missing() is not None, reason=str(simavr.missing()))
def test_the_sketch_on_an_atmega_streams_by_the_chips_own_clock(tmp_path: Path) -> None:
    firmware = simavr.compile_sketch("telepulse_sensor", tmp_path)
    board = simavr.compile_harness("sensor", tmp_path)
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
