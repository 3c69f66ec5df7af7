"""A process that holds measures, and tells as JSON how the kernel sees it before, meanwhile and
after. Given seconds, it runs on for so long without a pause, in the loop's thread or a helper's."""

import ctypes
import json
import logging
import os
import sys
import threading
import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import zmq

from protocol.host.realtime import hold, parse_realtime


def state() -> dict[str, Any]:
    me = threading.get_native_id()
    helpers = {thread.native_id or 0 for thread in threading.enumerate()} - {me}
    threads = {int(path.name): path for path in Path("/proc/self/task").iterdir()}
    named = {n for n, path in threads.items() if (path / "comm").read_text().startswith("ZMQ")}
    return {
        "loop": schedule(me),
        "helpers": sorted(map(schedule, helpers)),
        "zeromq": sorted({schedule(number) for number in named}),
        "others": sorted({schedule(number) for number in set(threads) - helpers - named - {me}}),
        "cpus": sorted(os.sched_getaffinity(me)),
        "helpers_cpus": sorted(os.sched_getaffinity(min(named))),
        "locked_kib": locked_kib(),
        "slack_ns": int(Path("/proc/self/timerslack_ns").read_text()),
    }


def schedule(thread: int) -> tuple[int, int]:
    return os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority


def locked_kib() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmLck"))


def spin(seconds: float) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        pass


def start_zeromq(until_the_end: ExitStack) -> None:
    context = until_the_end.enter_context(zmq.Context())
    until_the_end.enter_context(closing(context.socket(zmq.PUB)))


def start_foreign_thread() -> None:
    """A thread that neither Python nor ZeroMQ knows of, as numpy has; it sleeps for ever."""
    libc = ctypes.CDLL(None)
    assert libc.pthread_create(ctypes.byref(ctypes.c_ulong()), None, libc.pause, None) == 0


def main(wish: str, loop_s: float, helper_s: float) -> None:
    may_spin, done = threading.Event(), threading.Event()

    def help_the_loop() -> None:
        may_spin.wait()
        spin(helper_s)
        done.wait()

    # A daemon: a failure below must end the process.
    helper = threading.Thread(target=help_the_loop, daemon=True)
    helper.start()
    said: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: said.append(record.getMessage())  # type: ignore[method-assign]
    logging.getLogger().addHandler(handler)
    start_foreign_thread()
    with ExitStack() as until_the_end:
        start_zeromq(until_the_end)
        time.sleep(0.05)  # its threads have their names then
        told: dict[str, Any] = {"before": state()}
        with hold(parse_realtime(wish)) as held:
            told["held"] = state()
            may_spin.set()
            spin(loop_s)
            # Until the helper is through as well.
            time.sleep(2 * helper_s)
            told["later"] = state()
            told["granted"] = list(held.granted)
            told["refused"] = [str(refusal) for refusal in held.refused]
        told["after"] = state()
        told["said"] = said
    done.set()
    helper.join()
    json.dump(told, sys.stdout)


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), float(sys.argv[3]))
