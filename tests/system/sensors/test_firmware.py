"""The sketch of docs/firmware, compiled as C++ with an emulated board."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from pulse_sensors.binary_frames import FrameDecoder
from tests.support.nodes import ROOT
from tests.support.sample_blocks import forces

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
    compiled = subprocess.run(command, capture_output=True, text=True, check=False)
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
