"""Outputs that are not read: a terminal stopped by Ctrl-S, a full or closed pipe, a full disk."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from protocol.host.child_process import ChildProcess
from tests.support.nodes import ROOT

KINDS = ("terminal", "pipe", "closed", "full")
SIGTERM_BIT = 1 << 14


@contextmanager
def unread(kind: str) -> Iterator[int]:
    """Yield a descriptor that takes nothing: writing blocks (terminal, pipe) or fails."""
    if kind == "full":
        numbers = [os.open("/dev/full", os.O_WRONLY)]
    elif kind == "terminal":
        numbers = [*os.openpty()][::-1]
    else:
        numbers = [*os.pipe()][::-1]
    if kind == "closed":
        os.close(numbers.pop())
    if kind in ("terminal", "pipe"):
        fill(numbers[0])
    try:
        yield numbers[0]
    finally:
        for number in numbers:
            os.close(number)


def fill(number: int) -> int:
    """Write to a descriptor until it takes no more; return how many bytes it took."""
    os.set_blocking(number, False)
    written = 0
    for size in (4096, 1):
        try:
            while True:
                written += os.write(number, b"." * size)
        except BlockingIOError:
            pass
    os.set_blocking(number, True)
    return written


@contextmanager
def process_into(number: int, module: str, *arguments: str) -> Iterator[ChildProcess]:
    """Run a module of ours with both its outputs going to a descriptor."""
    command = ("-m", module, *arguments)
    with ChildProcess(module, *command, cwd=ROOT, stdout=number, stderr=number) as child:
        yield child


def obeys_sigterm(child: ChildProcess) -> bool:
    """Return whether the process has installed its handler; fail where it has ended."""
    assert child.poll() is None, child.args
    for line in Path(f"/proc/{child.pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("SigCgt:"):
            return bool(int(line.split()[1], 16) & SIGTERM_BIT)
    return False
