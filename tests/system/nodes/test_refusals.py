"""Command lines that no program starts with: one line says what is wrong, and where."""

import re
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from display_node.cli import app as display
from protocol.sockets import control_address
from sensing_node.cli import app as sensing
from telepulse.cli.main import app as telepulse
from telepulse.processes import HOST
from tests.support.log_lines import refused
from tests.support.nodes import RADIAL

HERE, ELSEWHERE = "tcp://127.0.0.1:5600", "tcp://192.0.2.7:5555"
BOARD = '[sensing.source]\nkind = "serial"\nport = "x"\nrate = "1 kHz"\nunit = "N"\n'
RECORDING = '[sensing.source]\nkind = "recording"\npath = "{}"\nrate = "1 kHz"\nunit = "N"\n'
FILES = {
    "board.toml": 'extends = "radial"\n' + BOARD + 'framing = "binary"\n',
    "large.toml": RECORDING.format("pulse.npy"),
    "taken": "mine",
}
NEEDS_KEYS = ("telepulse keys new", "--key", "--insecure")


def refusal(app: Any, *arguments: str) -> str:
    """Return the one line with which a program refuses its command line."""
    result = CliRunner().invoke(app, arguments)
    found = (result.exit_code, result.stdout, result.stderr.count("\n"))
    assert found == (2, "", 1), (arguments, result.output, result.exception)
    return result.stderr


@pytest.mark.parametrize(
    ("app", "arguments", "words"),
    [
        (display, "", ("no scene",)),
        *(
            (display, f"radial --no-screen --connect {wrong}", (wrong,))
            for wrong in ("localhost:5555", "tcp://localhost", "tcp://h:70000", "x")
        ),
        (display, f"radial --connect {ELSEWHERE}", (ELSEWHERE, "beyond this mach", *NEEDS_KEYS)),
        (display, "radial --telemetry tcp://*:*", ("tcp://*:*", "beyond this mach", *NEEDS_KEYS)),
        (display, "radial --discover --connect tcp://h:1", ("choose one",)),
        (display, "--doctor radial --json .", ("is a folder",)),
        (display, "radial --about subject=S01", ("add --record",)),
        *(
            (sensing, f"radial --bind {wrong}", (f"{wrong}: ",))
            for wrong in ("localhost:5555", "tcp://*:65535", "udp://h:1", "ipc://")
        ),
        (sensing, "radial --bind tcp://*:5555", ("tcp://*:5555", "beyond this mach", *NEEDS_KEYS)),
        (sensing, "radial --announce --bind ipc://stream", ("is on this machine alone",)),
        (sensing, "large.toml", ('reaches 400 N in unit "N"', 'set unit = "mN"')),
        *(
            (telepulse, f"relay --connect {HERE} --bind tcp://127.0.0.1:5655 {wrong}", (word,))
            for wrong, word in (
                (f"--connect {ELSEWHERE}", ELSEWHERE),
                ("--bind tcp://*:5655", "tcp://*:5655"),
                ("--connect wrist", "wrist"),
                ("--bind tcp://127.0.0.1:70000", "tcp://127.0.0.1:70000"),
            )
        ),
        (telepulse, f"link --connect {ELSEWHERE} --bind {HERE}", (f"{ELSEWHERE} reaches beyond",)),
        (telepulse, f"link --bind {ELSEWHERE} --connect {HERE}", (f"{ELSEWHERE} reaches beyond",)),
        (telepulse, f"view {HERE} --host 0.0.0.0", ("shows the page to all who reach",)),
        (telepulse, f"view {HERE} --host 192.0.2.7", ("--insecure",)),
        (telepulse, f"view {ELSEWHERE}", ("without keys",)),
        *(
            (telepulse, f"{command} --key no.key --insecure", ("choose one",))
            for command in (f"view {HERE}", f"record {HERE} a.mcap", f"mark {HERE}")
        ),
        # Here --insecure permits the page to be open, and its link has a key.
        (telepulse, f"view {HERE} --host 0.0.0.0 --insecure --key no.key", ("there is no such",)),
        (telepulse, "demo nowhere.toml", ("no such scene file",)),
        (telepulse, "demo --json nowhere/out.json", ("nowhere/out.json",)),
        (telepulse, "sweep radial", ("which only a sensing node can press",)),
        (telepulse, "sweep press --low 2N", ("--high 2.5 N: give at least twice --low",)),
        (telepulse, "sweep press --low 1mm", ("--low: ",)),
        (telepulse, "sweep press --record a.mcap", ("--record needs --connect",)),
        (telepulse, "simulate board.toml", ('source: kind "serial" is a live sensor',)),
        (telepulse, "emulate sensor radial --link taken", ("taken: cannot be made: ",)),
        (telepulse, "emulate cia402 tmcl_bench", ('kind = "cia402" is needed',)),
        (telepulse, "emulate tmcl no-such", ("no-such: no such scene",)),
        (telepulse, f"record {HERE} taken", ("exists already",)),
        *(
            (telepulse, f"{command} taken", ("taken: is not an MCAP file",))
            for command in ("replay", "report", "export --to csv")
        ),
        (telepulse, f"record {ELSEWHERE} a.mcap", ("--insecure",)),
    ],
)
def test_a_command_line_that_cannot_be_used_is_refused_in_one_line(
    app: Any,
    arguments: str,
    words: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    np.save("pulse.npy", 300 + 100 * np.sin(np.arange(100)))
    for name, text in FILES.items():
        Path(name).write_text(text, encoding="utf-8")
    # A node that starts nevertheless ends soon.
    ends = () if app is telepulse else ("--seconds", "0.2")
    line = refusal(app, *arguments.split(), *ends)
    for word in words:
        assert word in line
    # Nothing was overwritten.
    assert Path("taken").read_text(encoding="utf-8") == "mine"


def test_a_port_that_is_taken_is_refused_with_its_address(address: str) -> None:
    data, control = address.removeprefix("tcp://"), control_address(address).removeprefix("tcp://")
    for module, option, held in (
        ("sensing_node.cli", "--bind", data),
        ("sensing_node.cli", "--bind", control),
        ("display_node.cli", "--telemetry", data),
        ("display_node.cli", "--metrics", data),
    ):
        given = held if option == "--metrics" else address
        with socket.create_server((HOST, int(held.rpartition(":")[2]))):
            line = refused(module, str(RADIAL), option, given)
        assert re.search(f"cannot bind (tcp://)?{held}: .*in use", line), line
