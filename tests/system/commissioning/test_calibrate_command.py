import os
import pty
import threading
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from pulse_sensors.serial_port import SerialScene
from telepulse.cli.main import app

FIG_4 = "load,reading\n0,0\n0.5,22\n1,44\n2,88\n2.5,110\n"


def calibrate(*arguments: str, answers: str = "") -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["calibrate", *arguments], input=answers)
    return result.exit_code, result.stdout, result.stderr


def write(folder: Path, text: str) -> str:
    path = folder / "loads.csv"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (FIG_4, ()),
        ("# by hand\n\nReading [V], Load (mN)\n0,0\n0.044,1000\n0.11,2500\n", ()),
        ("weight_g,voltage_mV\n0,0\n101.9716,44\n254.929,110\n", ()),
        (
            "mass,volts\n0,0\n0.1019716,0.044\n0.254929,0.11\n",
            ("--load-unit", "kg", "--reading-unit", "V"),
        ),
    ],
)
def test_a_file_gives_the_lines_for_a_scene(
    text: str, options: tuple[str, ...], tmp_path: Path
) -> None:
    status, out, error = calibrate(write(tmp_path, text), *options)
    assert (status, error) == (0, "")
    assert 'sensitivity = "44 mV/N"' in out
    assert "Fig. 4 of Dargahi et al. (2008) has 44 mV/N" in out


def test_the_lines_are_valid_in_a_sensors_table(tmp_path: Path) -> None:
    text = "load,counts\n0,512\n1,400\n2,290\n"
    status, out, _ = calibrate(write(tmp_path, text), "--reading-unit", "counts")
    assert status == 0
    keys = dict(line.split(" = ") for line in out.splitlines() if " = " in line)
    table = {name: float(value) for name, value in keys.items()}
    port = {"kind": "serial", "port": "x", "framing": "text", "rate": "1 kHz"}
    sensor = SerialScene.model_validate({**port, "unit": "counts", **table})
    assert sensor.newtons(np.array([512.0, 290.0])) == pytest.approx((0.0, 2.0), abs=0.02)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "the file is empty"),
        ("load,reading\n0,0\n1,x\n", ":3: 'x' is not a number"),
        ("load,reading\n0,0\n1,nan\n", ":3: 'nan' is not a number"),
        ("load (lb),reading\n0,0\n", ":1: unknown unit 'lb'; known: N, mN, g, kg"),
        ("load (kg),reading\n0,0\n1e308,1\n", ":3: '1e308' is not a number that can be used"),
        (f"load,reading\n{'1' * 200_000},1\n", "cannot be read: field larger than field limit"),
        ("0,0\n1,44\n", "2 loads; at least 3"),
        ("0,0\n1,-44\n2,-88\n", "swap the film's wires"),
    ],
)
def test_a_bad_file_is_one_line_with_its_place(text: str, reason: str, tmp_path: Path) -> None:
    status, _, error = calibrate(write(tmp_path, text))
    assert status == 2
    assert error.count("\n") == 1
    assert reason in error


def test_a_live_sensor_is_calibrated_load_by_load(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("telepulse.commissioning.calibration.AVERAGE_S", 0.3)
    monkeypatch.setattr("telepulse.commissioning.calibration.SETTLE_S", 0.2)
    board, port = pty.openpty()
    scene = tmp_path / "board.toml"
    source = f'kind = "serial"\nport = "{os.ttyname(port)}"\nframing = "text"\nrate = "100 Hz"'
    names = 'names = ["announce", "cun", "chi"]'
    scene.write_text(f'[sensing.source]\n{source}\nunit = "mV"\n{names}\n', encoding="utf-8")
    asked: list[str] = []
    done = threading.Event()

    def say() -> None:
        """The board: of chi 3 mV, and 44 mV for each newton that was asked for last."""
        noise_mv = 0.01
        while not done.wait(0.01):
            load_n = float(asked[-1].split()[1]) if asked else 0.0
            noise_mv = -noise_mv
            os.write(board, f"0.5,7.5,{3 + 44 * load_n + noise_mv}\r\n".encode())

    def prompt(text: str, **_: object) -> str:
        asked.append(text)
        return ""

    monkeypatch.setattr("typer.prompt", prompt)
    talker = threading.Thread(target=say)
    talker.start()
    try:
        arguments = "--scene", str(scene), "--loads", "0, 1, 2 N"
        refused, _, reason = calibrate(*arguments)
        status, out, error = calibrate(*arguments, "--channel", "chi")
    finally:
        done.set()
        talker.join()
        os.close(board)
        os.close(port)
    assert refused == 2
    assert "several channels: choose with --channel one of ['cun', 'chi']" in reason
    assert (status, error) == (0, "")
    assert asked == [f"Put {load} N on, then press Enter" for load in (0, 1, 2)]
    assert 'sensitivity = "44 mV/N"' in out.replace("44.00", "44").replace("43.99", "44")
