"""A thread that no exception ends."""

import threading
import time

import pytest

from protocol.faults import FaultKind, Part, internal_fault
from protocol.host.guard import GuardedThread
from tests.support.waiting import until


@pytest.mark.parametrize("kind", [RuntimeError, MemoryError, SystemExit, OSError])
def test_a_thread_goes_on_after_whatever_its_step_raises(kind: type[BaseException]) -> None:
    steps, errors = [], []

    def step() -> None:
        steps.append(time.monotonic())
        time.sleep(0.001)
        raise kind("no")

    thread = GuardedThread("tested", step, errors.append)
    thread.start()
    until(lambda: len(errors) > 5)
    assert thread.is_alive()
    assert {type(error) for error in errors} == {kind}
    assert thread.stop(5.0)
    assert thread.errors == len(errors) <= len(steps)


def test_what_the_handler_raises_is_counted() -> None:
    def fail(*_: object) -> None:
        time.sleep(0.001)
        raise ValueError("no")

    thread = GuardedThread("tested", fail, fail)
    thread.start()
    until(lambda: thread.errors >= 6)
    assert thread.stop(5.0)


def test_a_step_that_hangs_is_reported_by_stop() -> None:
    go_on = threading.Event()
    thread = GuardedThread("tested", go_on.wait, print)
    thread.start()
    assert not thread.stop(0.05)
    assert thread.stopping
    go_on.set()
    assert thread.stop(5.0)


def test_the_fault_of_an_exception_has_its_place_and_thread() -> None:
    try:
        int("a")
    except ValueError as error:
        fault = internal_fault(Part.DRIVE, "drive x", error, 5)
    assert (fault.kind, fault.part, fault.at_ns) == (FaultKind.INTERNAL, Part.DRIVE, 5)
    assert str(fault).startswith("drive: ValueError: invalid literal for int()")
    assert "in test_guard.py:" in fault.cause
    assert fault.cause.endswith("(thread drive x)")
