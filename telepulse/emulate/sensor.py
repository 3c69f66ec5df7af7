"""`telepulse emulate sensor`: a sensor board on a pseudo-terminal, in real time."""

import time
from collections.abc import Callable
from pathlib import Path

from sensing_node.scene import SensingScene, build_source
from sensors.binary_frames import SampleFormat
from telepulse.emulate.pty_port import PtyPort
from telepulse.emulate.sensor_board import (
    NEWTONS_PER_COUNT,
    Habits,
    SensorBoard,
    binary,
    line,
    timed_line,
)

LINES = {"text": timed_line, "untimed": line}


def build_board(
    scene: SensingScene, folder: Path, framing: str, samples: SampleFormat, habits: Habits
) -> SensorBoard:
    """A board that plays the scene's source from now on; framing: "text", "untimed", "binary".

    Raises SceneError or SourceError.
    """
    # A real board sends what it has, plausible or not.
    source = build_source(scene, folder, plausible=False)
    encode = binary(samples) if framing == "binary" else LINES[framing]
    return SensorBoard(source, encode, habits, time.monotonic_ns())


def source_table(port: Path, rate_hz: float, framing: str, samples: SampleFormat) -> str:
    """The [sensing.source] of a scene that reads the board."""
    unit = ['unit = "N"']
    if framing == "binary" and samples != "float32":
        unit = ['unit = "counts"', f"newtons_per_count = {NEWTONS_PER_COUNT:g}"]
    lines = [
        "[sensing.source]",
        'kind = "serial"',
        f'port = "{port}"',
        f'framing = "{"binary" if framing == "binary" else "text"}"',
        *(['device_time = "us"'] if framing == "text" else []),
        f'rate = "{rate_hz:g} Hz"',
        *unit,
    ]
    return "\n".join(lines)


def play(board: SensorBoard, port: PtyPort, until_ns: int, stopped: Callable[[], bool]) -> None:
    """Write what the board sends until it is stopped, or then."""
    while not stopped() and (now_ns := time.monotonic_ns()) < until_ns:
        wait_ns = min(board.next_delivery_ns, until_ns) - now_ns
        if wait_ns > 0:
            time.sleep(min(wait_ns * 1e-9, 0.1))
        if time.monotonic_ns() >= board.next_delivery_ns:
            port.write(board.deliver(time.monotonic_ns()))
