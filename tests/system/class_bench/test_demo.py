"""`telepulse demo` on the emulated boards of a bench for a class, which it starts itself."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from subprocess import STDOUT

import pytest

from display_node.verdict import NOT_VALID_STATUS
from protocol.cli_options import FAULT_STATUS
from protocol.host.child_process import ChildProcess
from tests.support.emulated_bench import NICE, bench_scene_text
from tests.support.nodes import assert_accounted, process, read_json
from tests.system.drives.attempts import PATIENCE_MS, TRIES

WITHIN_S = 120.0
# A busy machine has held up a check, or the play.
BUSY = (1, FAULT_STATUS, NOT_VALID_STATUS)
WAITING = "this machine kept the emulated drive waiting for "
STOPPED_S = 0.2
TOO_BUSY = "This computer was too busy"
COMPILED = "the finger's board is its own sketch, compiled for this machine"


@contextmanager
def playing(folder: Path, *options: str, **streams: int) -> Iterator[ChildProcess]:
    """Run a demo whose temporary files are in a folder; check that it leaves none behind."""
    text = bench_scene_text(folder, "stepdir", PATIENCE_MS)
    (scene := folder / "class_bench.toml").write_text(text, encoding="utf-8")
    (temporary := folder / "temporary").mkdir(exist_ok=True)
    words = ("demo", str(scene), "--emulated", "--seconds", "5", *options)
    environment = {**os.environ, "TMPDIR": str(temporary)}
    with process("telepulse", *words, env=environment, **streams) as demo:
        # Other load on this machine must not look like a fault, where the priority is permitted.
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, demo.pid, NICE)
        yield demo
        assert list(temporary.iterdir()) == []


@pytest.mark.timeout(TRIES * WITHIN_S)
def test_one_command_checks_the_emulated_bench_and_plays(tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    options = ("--json", str(out), "--ui", "--no-page")
    for _ in range(TRIES):
        with playing(tmp_path, *options, stderr=STDOUT) as demo:
            output, _ = demo.communicate(timeout=WITHIN_S)
        if demo.returncode not in BUSY and TOO_BUSY not in output:
            break
    else:
        waited = [line for line in output.splitlines() if WAITING in line or TOO_BUSY in line]
        if waited:
            pytest.skip(waited[-1])
    assert demo.returncode == 0, output
    said, *lines = output.splitlines()
    assert said.startswith(COMPILED)
    assert lines[0] == "checking the bench"
    assert lines[1].startswith("checks: ")
    assert "fail" not in lines[1]
    # The display's warning comes before its drive moves, not with its summary.
    order = ("looks for its home", "playing", "  The pulse was felt for ")
    first = [next(n for n, line in enumerate(lines) if text in line) for text in order]
    assert first == sorted(first)
    summary = read_json(out)
    assert_accounted(summary["samples"])
    assert summary["samples"]["sent"] > 4500
    assert summary["beats"]["height_n"] == pytest.approx(0.3, rel=0.1)
    assert summary["force_rmse_n"]["aligned"] < 50e-3


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_demo_that_is_ended_in_its_check_takes_the_boards_with_it(
    number: signal.Signals, tmp_path: Path
) -> None:
    with playing(tmp_path, "--no-ui") as demo:
        assert demo.read_line(WITHIN_S).startswith(COMPILED)
        assert demo.read_line(WITHIN_S) == "checking the bench"
        (folder,) = (tmp_path / "temporary").iterdir()
        terminals = [(folder / end).resolve() for end in ("finger", "wrist")]
        assert all(terminal.exists() for terminal in terminals)
        demo.send_signal(number)
        demo.communicate(timeout=WITHIN_S)
        assert demo.returncode > 0
        assert not any(terminal.exists() for terminal in terminals)


def test_a_board_that_is_kept_waiting_is_reported(tmp_path: Path) -> None:
    with playing(tmp_path, "--no-ui") as demo:
        assert demo.read_line(WITHIN_S).startswith(COMPILED)
        assert demo.read_line(WITHIN_S) == "checking the bench"
        children = Path(f"/proc/{demo.pid}/task/{demo.pid}/children").read_text().split()
        (board,) = (
            int(pid)
            for pid in children
            if b"\0stepdir\0" in Path(f"/proc/{pid}/cmdline").read_bytes()
        )
        os.kill(board, signal.SIGSTOP)
        time.sleep(STOPPED_S)
        os.kill(board, signal.SIGCONT)
        time.sleep(STOPPED_S)
        demo.send_signal(signal.SIGINT)
        output, _ = demo.communicate(timeout=WITHIN_S)
        waited_ms = [float(text.split()[0]) for text in output.split(WAITING)[1:]]
        assert max(waited_ms) > 1e3 * STOPPED_S - 1
        assert not Path(f"/proc/{board}").exists()


def test_without_a_compiler_one_line_names_its_package(tmp_path: Path) -> None:
    environment = {**os.environ, "PATH": str(tmp_path)}
    for words in ("demo", "class_bench", "--emulated"), ("emulate", "stepdir", "class_bench"):
        with process("telepulse", *words, env=environment, stderr=STDOUT) as command:
            output, _ = command.communicate(timeout=WITHIN_S)
        assert command.returncode == 2, output
        (line,) = output.splitlines()
        assert "Debian: apt install g++" in line
