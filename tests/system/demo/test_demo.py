import os
import re
import signal
import sys
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from display_node.verdict import MOST_LINES, NOT_VALID_STATUS
from protocol.faults import FaultKind, faults_of
from tests.support.nodes import (
    RADIAL,
    ROOT,
    assert_accounted,
    process,
    read_json,
    run,
    run_python,
)
from tests.support.signal_files import pulse_and_ecg, wfdb_record

MODULE = "telepulse"
PATIENCE_S = 60.0
# A fast clock of the link: to it, all else takes fifty times as long.
FAST_CLOCK = """
import sys, time
if "link" in sys.orig_argv:
    counter_ns, begin_ns = time.perf_counter_ns, time.perf_counter_ns()
    time.perf_counter_ns = lambda: begin_ns + 50 * (counter_ns() - begin_ns)
"""


def assert_felt(figures: dict[str, Any]) -> None:
    """Check that the pulse of 0.3 N was felt.

    On a quiet machine the error is 0.3 mN, and all is within a just noticeable difference; a busy
    one holds up the loop. `tests/system/accuracy` bounds the errors in virtual time.
    """
    assert figures["within_jnd"] > 0.5
    assert figures["force_rmse_n"]["aligned"] < 50e-3


@pytest.mark.smoke
def test_the_demo_carries_the_pulse_and_accounts_for_every_sample(tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    result = run(MODULE, "demo", "--seconds", "4", "--json", str(out), "--no-ui")
    assert result.returncode == 0, result.stderr
    summary = read_json(out)
    samples = summary["samples"]
    assert_accounted(samples)
    assert samples["sent"] + samples["before_joining"] == 4000
    assert_felt(summary)
    title, *told = result.stdout.splitlines()
    assert title == "demo of radial, 4 s (every figure: --details)"
    assert len(told) <= MOST_LINES
    assert told[0].startswith("  The pulse was felt for ")
    assert any(f" {samples['sent']} samples" in line for line in told)
    assert result.stderr == ""


def test_a_demo_of_three_fingers_has_the_figures_of_each(tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    link = "delay=40ms,jitter=10ms,loss=1%"
    arguments = ("--seconds", "8", "--json", str(out), "--link", link, "--no-ui", "--details")
    result = run(MODULE, "demo", "three_fingers", *arguments)
    assert result.returncode == 0, result.stderr
    summary = read_json(out)
    assert_accounted(summary["samples"])
    assert summary["force_rmse_n"]["aligned"] is None
    heights_n = {}
    for name, figures in summary["contactors"].items():
        assert_felt(figures)
        assert f"{name}: aligned" in result.stdout
        assert_accounted(figures["samples"])
        assert figures["samples"]["sent"] == summary["samples"]["sent"]
        assert f"{name}: {figures['samples']['sent']} sent = " in result.stdout
        heights_n[name] = figures["beats"]["height_n"]
    expected_n = {"cun": 0.24, "guan": 0.3, "chi": 0.2}
    assert heights_n == pytest.approx(expected_n, rel=0.05)


def test_a_record_is_felt_by_one_command(tmp_path: Path) -> None:
    path, out = wfdb_record(tmp_path, pulse_and_ecg()), tmp_path / "out.json"
    result = run(
        MODULE, "demo", "--source", str(path), "--seconds", "5", "--json", str(out), "--no-ui"
    )
    assert result.returncode == 0, result.stderr
    assert "plays ABP (mmHg, 250 Hz), chosen by its pulse" in result.stderr
    assert "the ECG II (mV, 250 Hz) announces its beats" in result.stderr
    assert "lasts 4 s, and the run 5 s: it is played 1.25 times" in result.stderr
    summary = read_json(out)
    assert_accounted(summary["samples"])
    assert summary["samples"]["sent"] + summary["samples"]["before_joining"] == 1250
    assert_felt(summary)


def test_a_demo_whose_display_latches_a_fault_names_it_and_ends_with_status_3(
    tmp_path: Path,
) -> None:
    scene, out = tmp_path / "noisy.toml", tmp_path / "out.json"
    # The film's noise exceeds the overforce threshold.
    text = RADIAL.read_text(encoding="utf-8").replace(
        'force_limit = "2.5 N"', 'force_limit = "0.1 N"\noverforce = 1'
    )
    noise = '\n[display.film]\nnoise = "5 mN"\n'
    scene.write_text(text + noise, encoding="utf-8")
    result = run(MODULE, "demo", str(scene), "--seconds", "6", "--json", str(out), "--no-page")
    fault, advice = "film: felt force above 0.1 N", "check the film (telepulse calibrate)"
    assert result.returncode == 3
    assert result.stderr.startswith(f"telepulse: ended at the fault '{fault}': {advice}")
    assert result.stderr.count("\n") == 1
    # The line of each second names it, with what to do.
    assert re.search(rf"^alert: fault: {fault}: {re.escape(advice)}", result.stdout, re.MULTILINE)
    (found,) = faults_of(read_json(out))
    assert (found.kind, str(found)) == (FaultKind.OVERFORCE, fault)
    assert_accounted(read_json(out)["samples"])


def test_a_run_in_which_nothing_is_felt_says_so_first_and_ends_with_status_4(
    tmp_path: Path,
) -> None:
    scene = tmp_path / "slow.toml"
    # The ramp to full strength takes longer than the run.
    scene.write_text('extends = "radial"\n[display.safety]\nramp = "9 s"\n', encoding="utf-8")
    result = run(MODULE, "simulate", str(scene), "--seconds", "3")
    assert (result.returncode, result.stderr) == (NOT_VALID_STATUS, "")
    assert result.stdout.splitlines()[1].startswith("  This run is not valid: no pulse was felt; ")
    assert "Nothing is wrong" not in result.stdout


def test_the_first_line_says_where_the_page_is_and_ctrl_c_ends_the_pulse_and_sums_up(
    tmp_path: Path,
) -> None:
    out = tmp_path / "out.json"
    with process(MODULE, "demo", "--seconds", "100", "--json", str(out)) as demo:
        word, _, url = demo.read_line(PATIENCE_S).partition(" ")
        assert word == "page:"
        with urllib.request.urlopen(f"{url}/", timeout=30) as answer:
            assert "<title>telepulse: live</title>" in answer.read().decode()
        while not demo.read_line(PATIENCE_S).startswith("playing:"):
            pass
        demo.send_signal(signal.SIGINT)
        output, errors = demo.communicate(timeout=30)
    assert (demo.returncode, errors) == (0, "")
    assert "The pulse was felt for" in output
    assert_accounted(read_json(out)["samples"])


def test_without_bokeh_the_demo_names_the_extra_and_continues_unless_a_page_is_required() -> None:
    code = "import sys; sys.modules['bokeh'] = None; import telepulse.cli.main as c; c.main()"
    for page, status in ((), 0), (("--page",), 2):
        result = run_python("-c", code, "demo", "--seconds", "4", *page)
        assert result.returncode == status
        first = result.stderr.splitlines()[0]
        assert first.endswith("Bokeh is missing; pip install 'telepulse[view]'")
        assert ("The pulse was felt for" in result.stdout) == (status == 0)


def test_the_link_outlives_the_stream_however_slow_the_rest_is(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text(FAST_CLOCK, encoding="utf-8")
    out = tmp_path / "out.json"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    arguments = ("--link", "delay=1ms", "--seconds", "4", "--json", str(out), "--no-ui")
    with process(MODULE, "demo", *arguments, env=environment) as demo:
        _, errors = demo.communicate(timeout=PATIENCE_S)
    assert (demo.returncode, errors) == (0, "")
    samples = read_json(out)["samples"]
    assert_accounted(samples)
    assert samples["sent"] + samples["before_joining"] == 4000


@pytest.mark.skipif(sys.platform != "linux", reason="finds the parts in /proc")
@pytest.mark.parametrize(
    ("part", "name", "number", "status"),
    [
        ("link", "link between the nodes", signal.SIGKILL, "-9"),
        ("link", "link between the nodes", signal.SIGTERM, "0"),
        ("display_node.cli", "display node", signal.SIGKILL, "-9"),
        # 4 on a machine that is so slow that the run is not valid.
        ("display_node.cli", "display node", signal.SIGTERM, "[04]"),
        ("sensing_node.cli", "sensing node", signal.SIGKILL, "-9"),
    ],
)
def test_a_part_that_ends_early_is_named_with_its_status(
    part: str, name: str, number: signal.Signals, status: str
) -> None:
    with process(MODULE, "demo", "--link", "delay=1ms", "--seconds", "100", "--no-page") as demo:
        while not demo.read_line(PATIENCE_S).startswith("playing:"):
            pass
        children = Path(f"/proc/{demo.pid}/task/{demo.pid}/children").read_text().split()
        (pid,) = (
            int(pid)
            for pid in children
            if f"\0{part}\0" in Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8")
        )
        os.kill(pid, number)
        _, errors = demo.communicate(timeout=PATIENCE_S)
    assert demo.returncode == 2
    early = f"telepulse: the {name} ended early with status {status}: it printed no reason\n"
    assert re.fullmatch(early, errors)
