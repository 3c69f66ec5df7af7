"""Nodes as processes of a soak: start, supervise, stop, kill and measure them."""

import asyncio
import json
import os
import signal
import time
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from soak.accounts import Mark
from soak.claims import StatusClaim
from soak.core_time import CoreTime
from telepulse.processes import NodeProcess
from tests.support.netem import Namespace

# A node prints this when its loop begins.
_UP = {"sensing_node.cli": "streaming ", "display_node.cli": "waiting for "}
POLL_S = 0.01
UP_WITHIN_S = 20.0
ENDS_WITHIN_S = 10.0


@dataclass(frozen=True, slots=True)
class Usage:
    """Resources of a process: anonymous memory in RAM or swapped out, descriptors, threads.

    Not PSS, which changes when another process that shares a library starts or ends.
    """

    at_ns: int
    memory_bytes: int
    descriptors: int
    threads: int


@dataclass(slots=True)
class SoakProcess:
    """A process of a node. ending: "stopped" or "killed" if the soak ended it, else None.

    For a display, claims has its statuses, and core_times the times that its loop has waited for a
    processor.
    """

    role: str
    process: NodeProcess
    errors: Path
    result: Path
    began_ns: int
    up_text: str
    up_ns: int | None = None
    over_ns: int | None = None
    ending: str | None = None
    usage: list[Usage] = field(default_factory=list)
    marks: list[Mark] = field(default_factory=list)
    claims: list[StatusClaim] = field(default_factory=list)
    core_times: list[CoreTime] = field(default_factory=list)
    # Summary in a display's last status; None without one.
    summary: dict[str, Any] | None = None
    frozen_ns: int = 0

    @property
    def running(self) -> bool:
        """True until the process has ended."""
        if self.over_ns is None and self.process.poll() is not None:
            self.over_ns = time.perf_counter_ns()
        return self.over_ns is None

    async def up(self) -> int:
        """Wait until its loop runs or it has ended, and return the time."""
        until_ns = time.perf_counter_ns() + round(UP_WITHIN_S * 1e9)
        while self.up_ns is None and self.running and time.perf_counter_ns() < until_ns:
            if self.up_text in self.errors.read_text(encoding="utf-8"):
                self.up_ns = time.perf_counter_ns()
            else:
                await asyncio.sleep(POLL_S)
        return self.up_ns or time.perf_counter_ns()

    def kill(self) -> None:
        """Kill it with SIGKILL, so that it reports nothing at its end."""
        if self.running:
            self.ending = "killed"
            self.process.kill()
            self.process.wait()
            self.over_ns = time.perf_counter_ns()

    async def stop(self) -> None:
        """Send SIGTERM and wait; kill a node that does not end, as its exit status shows."""
        if self.running:
            self.ending = "stopped"
            await asyncio.to_thread(self.process.stop, ENDS_WITHIN_S)
            self.over_ns = self.over_ns or time.perf_counter_ns()

    async def freeze(self, seconds: float) -> None:
        """Stop it with SIGSTOP for some time."""
        began_ns = time.perf_counter_ns()
        self.process.send_signal(signal.SIGSTOP)
        await asyncio.sleep(seconds)
        self.process.send_signal(signal.SIGCONT)
        self.frozen_ns += time.perf_counter_ns() - began_ns

    def measure(self) -> None:
        """Record its present resources."""
        if not self.running:
            return
        folder = Path("/proc", str(self.process.pid))
        with suppress(OSError):  # it has ended
            status = (folder / "status").read_text(encoding="ascii").splitlines()
            table = dict(line.split(":", 1) for line in status if ":" in line)
            if "RssAnon" in table:
                kilobytes = sum(int(table[key].split()[0]) for key in ("RssAnon", "VmSwap"))
                handles = len(os.listdir(folder / "fd"))
                now_ns = time.perf_counter_ns()
                self.usage.append(Usage(now_ns, kilobytes * 1024, handles, int(table["Threads"])))

    def result_summary(self) -> dict[str, Any] | None:
        """Return the summary it wrote at its end; None without one."""
        if not self.result.exists():
            return None
        table: dict[str, Any] = json.loads(self.result.read_text(encoding="utf-8"))
        return table

    def sent(self) -> int | None:
        """Return the number of samples it reported as sent; None without a report."""
        table = self.result_summary()
        return None if table is None else table["samples"]["sent"]

    def complaint(self) -> str | None:
        """Return the error at its end, once it has ended; None without one."""
        status = self.process.returncode
        wrong = {"stopped": status != 0, "killed": status != -signal.SIGKILL}
        if self.ending is None or wrong[self.ending]:
            said = self.errors.read_text(encoding="utf-8").strip().splitlines()[-1:]
            what = self.ending or "left alone"
            return f"{self.role}, {what}, ended with status {status}: {''.join(said)}"
        if "Traceback" in self.errors.read_text(encoding="utf-8"):
            return f"{self.role} printed a traceback"
        return None


def begin(
    role: str, folder: Path, number: int, namespace: Namespace | None, module: str, *arguments: str
) -> SoakProcess:
    """Start a node in a namespace, or in this one; its output goes to files in `folder`."""
    output, errors, result = (
        folder / f"{role}-{number}.{kind}".replace(" ", "-") for kind in ("out", "err", "json")
    )
    entered = nullcontext() if namespace is None else namespace.entered()
    with output.open("wb") as out, errors.open("wb") as err, entered:
        node = NodeProcess(role, module, *arguments, summary=result, stdout=out, stderr=err)
    return SoakProcess(role, node, errors, result, time.perf_counter_ns(), _UP[module])
