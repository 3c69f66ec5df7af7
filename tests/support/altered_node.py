"""`python -m tests.support.altered_node ALTERATION MODULE ARGUMENTS`: a node with a fault in it.

`step=SECONDS`: its monotonic clock steps by so much at each SIGUSR1. To simulate a suspended host,
stop the process, and step its clock back by the time for which it was stopped. `flood=data` or
`flood=control`: a sensing node that sends each frame, or each control answer, hundreds of times.
`raise=METHOD,ERROR,MOMENT,FILE`: a method of a drive's device, as "module:class.method", raises an
error once: while homing, running (at SIGUSR1) or in the withdrawal; FILE gets the time of it.
`held=METHOD`: once the run has ended, that method gets the velocity 0, so that no tip leaves.
"""

import importlib
import runpy
import signal
import sys
import termios
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import zmq

STEP = signal.SIGUSR1
# Copies of each message: 75 000 frames a second.
COPIES = {"data": 375, "control": 1_500}
ERRORS = {
    "RuntimeError": RuntimeError("no"),
    "MemoryError": MemoryError(),
    "termios.error": termios.error(5, "Input/output error"),
}
HOMING, RUNNING, WITHDRAWAL = "homing", "running", "withdrawal"


def make_clock_step(seconds: str) -> None:
    """Step the monotonic clock at each signal."""
    step_ns = round(float(seconds) * 1e9)
    steady_ns = time.perf_counter_ns
    steps = 0

    def step(*_: object) -> None:
        nonlocal steps
        steps += 1

    signal.signal(STEP, step)
    time.perf_counter_ns = lambda: steady_ns() + steps * step_ns


def send_copies(port: str) -> None:
    """Send every message of a port many times, past the send queue's own limit."""
    from protocol import sockets
    from sensing_node import node

    send = sockets.send

    def send_many(socket: sockets.Socket, *parts: bytes) -> bool:
        flooded = (socket.socket_type == zmq.XPUB) == (port == "data")
        sent = [send(socket, *parts) for _ in range(COPIES[port] if flooded else 1)]
        return any(sent)

    sockets.send = send_many
    limits = node.queue_limits
    node.queue_limits = lambda description: {**limits(description), zmq.SNDHWM: 100_000}


def _method(name: str) -> tuple[Any, str]:
    """Return the class and the name of a method that is named with its module."""
    module, _, method = name.partition(":")
    owner, _, attribute = method.partition(".")
    return getattr(importlib.import_module(module), owner), attribute


def _on_fault(happens: Callable[[Any], None]) -> None:
    """Call a function with each fault that a drive latches, an end of its run included."""
    from pulse_drives.supervisor import Supervisor

    fail = Supervisor.fail

    def failing(supervisor: Any, fault: Any, *arguments: Any, **options: Any) -> None:
        fail(supervisor, fault, *arguments, **options)
        happens(fault)

    Supervisor.fail = failing


def make_method_raise(value: str) -> None:
    """Let a method raise once, at a moment."""
    target, error, moment, file = value.split(",")
    owner, name = _method(target)
    method = getattr(owner, name)
    armed = raised = False

    def arm(*_: Any) -> None:
        nonlocal armed
        armed = True

    def raising(*arguments: Any, **options: Any) -> Any:
        nonlocal raised
        if armed and not raised:
            raised = True
            Path(file).write_text(str(time.perf_counter_ns()), encoding="utf-8")
            raise ERRORS[error]
        return method(*arguments, **options)

    setattr(owner, name, raising)
    if moment == RUNNING:
        signal.signal(STEP, arm)
    elif moment == WITHDRAWAL:
        _on_fault(arm)
    else:
        _arm_while_homing(arm)


def _arm_while_homing(arm: Callable[[], None]) -> None:
    from pulse_drives import drive

    guard = drive.TouchGuard.__call__

    def guarding(touch_guard: Any) -> None:
        arm()
        guard(touch_guard)

    # It is called repeatedly in each search for home.
    drive.TouchGuard.__call__ = guarding


def hold_at_the_end(value: str) -> None:
    """Let a method that takes a velocity as its last argument get 0 once the run has ended."""
    from protocol.faults import FaultKind

    owner, name = _method(value)
    method = getattr(owner, name)
    ended = False

    def end(fault: Any) -> None:
        nonlocal ended
        ended = ended or fault.kind is FaultKind.ENDED

    def holding(*arguments: Any) -> Any:
        return method(*arguments[:-1], 0) if ended else method(*arguments)

    setattr(owner, name, holding)
    _on_fault(end)


if __name__ == "__main__":
    alteration, _, value = sys.argv[1].partition("=")
    alterations = {
        "step": make_clock_step,
        "flood": send_copies,
        "raise": make_method_raise,
        "held": hold_at_the_end,
    }
    alterations[alteration](value)
    del sys.argv[:2]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
