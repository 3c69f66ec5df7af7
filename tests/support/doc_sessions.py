"""Sessions of commands as a reader types them: in a folder, in order, some in parallel."""

import os
import re
import shlex
import shutil
import signal
import sysconfig
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from subprocess import DEVNULL, STDOUT

from protocol.host.child_process import ChildProcess
from telepulse.processes import free_addresses
from tests.support.doc_commands import recipes
from tests.support.nodes import ROOT
from tests.support.waiting import until

BIN = Path(sysconfig.get_path("scripts"))
LONGEST_S = 60


@dataclass(frozen=True)
class Step:
    """A command as written on a page.

    `more` is appended; otherwise only the places of `Session` are replaced. `at` is the folder in
    which it is run. With `shows`, it keeps running beside the next steps once it has printed that
    pattern, and is ended by Ctrl-C. `statuses`: the exit statuses that it may have.
    """

    command: str
    more: str = ""
    at: str = "."
    shows: str | None = None
    says: str = ""
    statuses: tuple[int, ...] = (0,)


@dataclass(frozen=True)
class Stop:
    """A Ctrl-C in the terminal of a command."""

    command: str


Do = Callable[[Path], None]


class Session:
    """A folder with the scenes in it, and the running commands."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(ROOT / "scenes", folder / "scenes")
        ports = [address.rpartition(":")[2] for address in free_addresses(4)]
        self.places = {
            r"\b5555\b": ports[0],
            r"\b5655\b": ports[1],
            r"\bPORT\b": ports[2],
            r"\b9100\b": ports[3],
            r"\b9101\b": str(int(ports[3]) + 1),
            r"\b(HOST|SENSING)\b": "127.0.0.1",
            r"\bSCENE\b": "tmcl_bench",
            r"/tmp/": f"{folder}/",
        }
        for scene in (folder / "scenes").glob("*.toml"):
            scene.write_text(self.placed(scene.read_text(encoding="utf-8")), encoding="utf-8")
        self._running: dict[str, tuple[ChildProcess, Path, Step]] = {}

    def placed(self, text: str) -> str:
        """Return a command with this session's ports, hosts and folders."""
        for place, ours in self.places.items():
            text = re.sub(place, ours, text)
        return text

    def play(self, steps: Sequence[Step | Stop | Do]) -> None:
        """Run all steps; stop what still runs at the end, the last one first."""
        with ExitStack() as until_the_end:
            for step in steps:
                if isinstance(step, Step):
                    self._type(step, until_the_end)
                elif isinstance(step, Stop):
                    self._stop(step.command)
                else:
                    step(self.folder)

    def _type(self, step: Step, until_the_end: ExitStack) -> None:
        where = self.folder / step.at
        if not where.exists():
            where.mkdir()
            shutil.copytree(self.folder / "scenes", where / "scenes")
        line = self.placed(step.command)
        if line.startswith("make "):
            (line,) = recipes(shlex.split(line)[1:])
        program, *words = shlex.split(f"{line} {self.placed(step.more)}")
        printed = self.folder / f"{len(list(self.folder.glob('*.printed')))}.printed"
        with printed.open("w", encoding="utf-8") as output:
            child = ChildProcess(
                program,
                *(str(BIN / program), *words),
                cwd=where,
                stdin=DEVNULL,
                stdout=output,
                stderr=STDOUT,
                env={**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "200"},
            )
        self._running[step.command] = child, printed, step
        until_the_end.callback(self._stop, step.command)
        if step.shows is None:
            child.wait(LONGEST_S)
            self._stop(step.command)
            assert step.says in printed.read_text(encoding="utf-8")
        else:
            pattern = step.shows
            with suppress(AssertionError):
                until(lambda: _has(printed, pattern) or child.poll() is not None, LONGEST_S)
            assert _has(printed, pattern), _failure(line, printed)

    def _stop(self, command: str) -> None:
        """End it by Ctrl-C if it still runs, and check its exit status."""
        if command not in self._running:
            return
        child, printed, step = self._running.pop(command)
        if child.poll() is None:
            child.send_signal(signal.SIGINT)
        try:
            status = child.wait(LONGEST_S)
        finally:
            if child.poll() is None:
                child.kill()
                child.wait()
        assert status in step.statuses, _failure(f"{command}: exit status {status}", printed)


def _has(printed: Path, pattern: str) -> bool:
    return re.search(pattern, printed.read_text(encoding="utf-8")) is not None


def _failure(what: str, printed: Path) -> str:
    return f"{what}\n{printed.read_text(encoding='utf-8')[-2000:]}"
