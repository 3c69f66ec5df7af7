"""The commands as people use them: files, processes, a terminal."""

import json
import os
import pty
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import PIPE
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from protocol.host.child_process import ChildProcess
from telepulse.cli.main import app
from telepulse.experiment.log import SessionLog, open_log, read_log
from telepulse.experiment.session import load_plan
from tests.support.experiment_sessions import condition, write
from tests.support.nodes import ROOT, known
from tests.support.waiting import PATIENCE_S, until

PLAIN = condition("plain")
KEYS = "abx1"


def experiment(*arguments: object) -> Result:
    return CliRunner().invoke(app, ["experiment", *map(str, arguments)])


def observed(session: Path, threshold: str, log: Path, *options: str) -> SessionLog:
    """Run a session with a simulated observer; return its log."""
    result = experiment("run", session, "--log", log, "--observer", threshold, *options)
    assert result.exit_code == 0, result.output
    return read_log(log)


def process(session: Path, *options: str, **pipes: Any) -> ChildProcess:
    """Start `telepulse experiment run` in the session's folder."""
    command = ("-m", "telepulse", "experiment", "run", session.name, *options)
    if "--observer" not in options:
        command += ("--without-drive",)
    return ChildProcess("session", *command, cwd=session.parent, **pipes)


def lines(log: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]


def test_a_killed_session_continues_as_if_unbroken(tmp_path: Path) -> None:
    session = write(tmp_path / "s.toml", PLAIN, trials=6)
    whole = observed(session, "5 %", tmp_path / "whole.jsonl")
    log = tmp_path / "killed.jsonl"
    with process(session, "--log", log.name, "--observer", "5 %") as child:
        until(lambda: log.exists() and log.read_bytes().count(b"\n") >= 3)
        child.kill()
    assert 2 <= len(read_log(log).answered) < 6
    with log.open("ab") as file:
        file.write(b'{"line":"trial","ti')
    killed = observed(session, "5 %", log, "--resume")
    assert len(killed.answered) == 6
    assert killed.header.trials == whole.header.trials
    assert [(a.answer, a.played) for a in killed.answered] == [
        (a.answer, a.played) for a in whole.answered
    ]
    assert [line["line"] for line in lines(log)].count("resumed") == 1


@contextmanager
def terminal(session: Path, *options: str) -> Iterator[tuple[ChildProcess, int]]:
    """Run a session whose keyboard is a terminal; its output is a pipe."""
    ours, theirs = pty.openpty()
    try:
        with process(session, *options, stdin=theirs, stdout=PIPE) as child:
            yield child, ours
    finally:
        os.close(ours)
        os.close(theirs)


def read_until(child: ChildProcess, wanted: str) -> str:
    """Return the output up to the line with some words."""
    output = ""
    while wanted not in output:
        output += child.read_line(PATIENCE_S)
    return output


def test_a_person_answers_by_keys_and_stops_in_the_midst_of_an_interval(tmp_path: Path) -> None:
    session = write(tmp_path / "s.toml", PLAIN, kind="rating", interval="0.5 s")
    with terminal(session, "--log", "log.jsonl") as (child, keys):
        read_until(child, "trial 1 of 2")
        # The sequence of an arrow key ends with an A, which is not the key A.
        os.write(keys, b"\x1b[A")
        os.write(keys, b"ax4")
        output = read_until(child, "trial 2 of 2")
        assert output.count("is over") == 2
        os.write(keys, b"A")
        read_until(child, "A ...")
        os.write(keys, b"q")
        output = read_until(
            child, "stopped; continue: telepulse experiment run s.toml --log log.jsonl"
        )
        assert "is over" not in output
        assert child.wait(20) == 0
    (answered,) = read_log(tmp_path / "log.jsonl").answered
    assert answered.answer == 4
    assert known(answered.response_s) > 1
    assert [(p.letter, p.on_link) for p in answered.played] == [("A", False), ("X", True)]
    assert any(p.felt_s > 0 for p in answered.played)


def test_the_output_before_the_end_does_not_depend_on_what_x_is(tmp_path: Path) -> None:
    outputs, children = [], []
    for number in range(2):
        (folder := tmp_path / str(number)).mkdir()
        session = write(folder / "s.toml", PLAIN)
        file, header, _ = open_log(folder / "log.jsonl", load_plan(session), None, resume=False)
        file.close()
        if number:
            table = json.loads(header.model_dump_json())
            flip = {"A": "B", "B": "A"}
            for trial in table["trials"]:
                trial["x"] = flip[trial["x"]]
            (folder / "log.jsonl").write_text(json.dumps(table) + "\n", encoding="utf-8")
        pipes = {"stdin": PIPE, "stdout": PIPE, "stderr": PIPE}
        child = process(session, "--log", "log.jsonl", "--resume", **pipes)
        children.append(child)
        assert child.stdin is not None
        child.stdin.write(KEYS + "a1")
        child.close_input()
    for child in children:
        outputs.append(child.communicate(timeout=60))
        assert child.returncode == 0
    assert outputs[0] == outputs[1]
    assert "feel B and X first" in outputs[0][0]
    logs = [read_log(tmp_path / str(number) / "log.jsonl") for number in range(2)]
    assert [len(log.answered) for log in logs] == [1, 1]
    on_link = [[p.on_link for p in log.answered[0].played] for log in logs]
    assert on_link[0][:2] == on_link[1][:2]
    assert on_link[0][2] != on_link[1][2]
    assert {log.answered[0].correct for log in logs} == {False, True}


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("run", "none.toml", "--log", "x"), "none.toml: no such session file"),
        (
            ("run", "s.toml", "--log", "there", "--without-drive"),
            "exists already; continue it by --resume",
        ),
        (("run", "s.toml", "--log", "x"), "has no [display.drive]"),
        (("run", "live.toml", "--log", "x", "--observer", "5 %"), "is a live sensor"),
        (("run", "s.toml", "--log", "x", "--observer", "-1"), "'-1' must be more than 0"),
        (
            ("run", "s.toml", "--log", "garbage", "--resume", "--without-drive"),
            "garbage: line 1: not a line of a session's log",
        ),
        (("new", "s.toml"), "s.toml: exists already; name another file"),
    ],
)
def test_an_impossible_request_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], reason: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "s.toml")
    write(tmp_path / "live.toml", scene="tmcl_bench")
    (tmp_path / "there").touch()
    (tmp_path / "garbage").write_text("{}\n", encoding="utf-8")
    result = experiment(*arguments)
    assert result.exit_code == 2
    assert reason in result.stderr
    if not result.stderr.startswith("Usage"):
        assert result.stderr.count("\n") == 1


def test_a_log_continues_only_with_its_own_session(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    observed(write(tmp_path / "s.toml", trials=1), "5 %", log)
    other = write(tmp_path / "s.toml", trials=2)
    result = experiment("run", other, "--log", log, "--observer", "5 %", "--resume")
    assert result.exit_code == 2
    assert "session, scene or observer differ from those in the log's first line" in result.stderr


def test_a_session_ends_safely_on_sigterm(tmp_path: Path) -> None:
    session = write(tmp_path / "s.toml", interval="30 s")
    with terminal(session, "--log", "log.jsonl") as (child, keys):
        read_until(child, "trial 1 of 2")
        os.write(keys, b"a")
        read_until(child, "A ...")
        child.send_signal(signal.SIGTERM)
        read_until(child, "stopped; continue")
        assert child.wait(20) == 0


# 68 trials in virtual time.
@pytest.mark.timeout(400)
def test_the_example_with_the_page_s_seed_gives_what_the_page_shows(tmp_path: Path) -> None:
    session = tmp_path / "mine.toml"
    assert experiment("new", session).exit_code == 0
    written = session.read_text(encoding="utf-8")
    seeded = re.sub(r"^# (seed = 1) ", r"\1 ", written, flags=re.MULTILINE)
    assert seeded != written
    session.write_text(seeded, encoding="utf-8")
    result = experiment("run", session, "--log", tmp_path / "o.jsonl", "--observer", "5 %")
    assert result.exit_code == 0, result.output
    page = (ROOT / "docs/experiment.md").read_text(encoding="utf-8")
    row = re.compile(r"[|│] ([\w ,]+?) +[|│] (\d+ of 16) +[|│] ([\d. to]+ %) ")
    shown = row.findall(page)
    assert len(shown) == 4
    assert row.findall(result.stdout) == shown
