"""A process that takes real-time measures, and prints what they are in the kernel.

It computes for some seconds in the loop's thread, or in a helper's.
"""

import json
import logging
import os
import sys
import threading
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import zmq

from protocol.host.realtime import apply_realtime, parse_realtime


def state() -> dict[str, Any]:
    me = threading.get_native_id()
    helpers = {thread.native_id or 0 for thread in threading.enumerate()} - {me}
    threads = schedules()
    named = {
        n for n in threads if Path(f"/proc/{n}/comm").read_text(encoding="utf-8").startswith("ZMQ")
    }
    return {
        "loop": threads[me],
        "helpers": sorted(threads[number] for number in helpers),
        "zeromq": sorted({threads[number] for number in named}),
    }


def schedules(process: int | str = "self") -> dict[int, tuple[int, int]]:
    """Return policy and priority of each thread of a process."""
    return {
        number: (os.sched_getscheduler(number), os.sched_getparam(number).sched_priority)
        for number in map(int, os.listdir(f"/proc/{process}/task"))
    }


def locked_kib(process: int) -> int:
    lines = Path(f"/proc/{process}/status").read_text(encoding="utf-8").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmLck"))


def spin(seconds: float) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        pass


def main(wish: str, loop_s: float, helper_s: float) -> None:
    may_spin, done = threading.Event(), threading.Event()

    def help_the_loop() -> None:
        may_spin.wait()
        spin(helper_s)
        done.wait()

    # A daemon: a failure below must end the process.
    helper = threading.Thread(target=help_the_loop, daemon=True)
    helper.start()
    messages: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: messages.append(record.getMessage())  # type: ignore[method-assign]
    logging.getLogger().addHandler(handler)
    found: dict[str, Any] = {"messages": messages}
    with zmq.Context() as context, closing(context.socket(zmq.PUB)):
        time.sleep(0.05)  # its threads have their names then
        with apply_realtime(parse_realtime(wish)) as held:
            found["held"] = state()
            may_spin.set()
            spin(loop_s)
            # Until the helper is through as well.
            time.sleep(2 * helper_s)
            found["later"] = state()
            found["granted"] = list(held.granted)
    done.set()
    helper.join()
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), float(sys.argv[3]))
