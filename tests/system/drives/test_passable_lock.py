"""The lock that a stalled loop cannot keep."""

import threading

import pytest

from display_node.drives import supervisor
from display_node.drives.supervisor import PassableLock

LONG_S = 30.0


def test_a_holder_that_stands_still_is_passed_by(monkeypatch: pytest.MonkeyPatch) -> None:
    lock = PassableLock()
    monkeypatch.setattr(supervisor, "PATIENCE_S", 0.01)
    with lock:
        with lock.passing():
            pass
        # The next one does not wait, or this test would take its time limit.
        monkeypatch.setattr(supervisor, "PATIENCE_S", 10 * LONG_S)
        with lock.passing():
            pass


def test_once_it_can_be_had_again_it_excludes_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    lock, seen = PassableLock(), list[str]()
    monkeypatch.setattr(supervisor, "PATIENCE_S", 0.01)
    with lock, lock.passing():
        pass
    monkeypatch.setattr(supervisor, "PATIENCE_S", LONG_S)
    with lock.passing():
        pass
    waits = threading.Event()

    def drive() -> None:
        waits.set()
        with lock.passing():
            seen.append("drive")

    thread = threading.Thread(target=drive)
    with lock:
        thread.start()
        assert waits.wait(LONG_S)
        seen.append("loop")
    thread.join(LONG_S)
    assert seen == ["loop", "drive"]
