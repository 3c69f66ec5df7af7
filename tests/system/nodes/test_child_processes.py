"""Child processes: silent, failing and endless ones, and in a folder with modules of our names."""

import sys
from collections.abc import Iterator
from pathlib import Path
from subprocess import PIPE

import pytest

from display_node.verdict import NOT_VALID_STATUS
from protocol.host.child_process import ChildProcess
from tests.support.nodes import RADIAL, ROOT, free_address
from tests.support.waiting import until

PATIENCE_S = 60.0
PARENT = """
import threading
from protocol.host.child_process import ChildProcess

def start():
    children.append(ChildProcess("child", "-c", "import time; time.sleep(600)"))

children = []
thread = threading.Thread(target=start)
thread.start()
thread.join()
print(children[0].pid, flush=True)
threading.Event().wait(600)
"""
NAMES = (
    "protocol",
    "telepulse",
    "sensors",
    "pulse_sensors",
    "pulse_drives",
    "sensing_node",
    "display_node",
)


@pytest.fixture
def hostile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Change to a folder with modules of our names, none of which may be imported."""
    folder = tmp_path / "hostile"
    folder.mkdir()
    for name in NAMES:
        text = f"open(r'{folder}/imported', 'a').write('{name}')\nraise SystemExit('{name}.py')\n"
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    monkeypatch.chdir(folder)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    yield
    assert not (folder / "imported").exists(), (folder / "imported").read_text(encoding="utf-8")


@pytest.mark.skipif(sys.platform != "linux", reason="the signal at the end of a pipe is Linux's")
def test_a_child_ends_with_its_killed_parent_and_not_with_the_thread_that_started_it() -> None:
    with ChildProcess("parent", "-c", PARENT, stdout=PIPE, stderr=PIPE) as parent:
        child = int(parent.read_line(PATIENCE_S))
        assert is_running(child)
        parent.kill()
        parent.wait()
        until(lambda: not is_running(child))


def is_running(pid: int) -> bool:
    """Return whether a process has not ended; one that its parent has not awaited has."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8")
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"


@pytest.mark.usefixtures("hostile")
def test_the_processes_beside_a_node_import_nothing_of_the_current_folder(tmp_path: Path) -> None:
    """Metrics, recorder and screen of a display; the metrics of a sensing node."""
    address, recording = free_address(), tmp_path / "a.mcap"
    play = ("--connect", address, "--seconds", "2", "--record", str(recording), "--metrics", "0")
    sense = ("--bind", address, "--seconds", "2", "--metrics", "0")
    piped = {"stdout": PIPE, "stderr": PIPE}
    with (
        ChildProcess("display", "-m", "display_node.cli", str(RADIAL), *play, **piped) as display,
        ChildProcess("sensing", "-m", "sensing_node.cli", str(RADIAL), *sense, **piped) as sensing,
    ):
        sensing.await_end(PATIENCE_S)
        display.await_end(PATIENCE_S, (NOT_VALID_STATUS,))
    assert recording.stat().st_size > 0


def test_a_process_that_ignores_sigterm_is_killed() -> None:
    code = "import signal, time; signal.signal(15, signal.SIG_IGN); print(1, flush=True)"
    with ChildProcess("program", "-c", f"{code}; time.sleep(60)", stdout=PIPE) as child:
        child.read_line(PATIENCE_S)
        assert child.stop(within_s=0.2) == -9
