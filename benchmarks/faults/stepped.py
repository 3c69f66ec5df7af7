"""`python -m benchmarks.faults.stepped MODULE ARGUMENTS`: a node whose clock steps when it is told.

The step, in seconds, is in the environment; each signal is one more. A host that was suspended is
a process that was stopped, and whose clock has not gone on meanwhile: a step back by as much.
"""

import os
import runpy
import signal
import sys
import time

STEP = signal.SIGUSR1
STEP_VARIABLE = "FAULT_STEP_S"


def main() -> None:
    """Run a module on a clock that can step."""
    step_ns = round(float(os.environ[STEP_VARIABLE]) * 1e9)
    steady_ns = time.monotonic_ns
    steps = 0

    def step(*_: object) -> None:
        nonlocal steps
        steps += 1

    signal.signal(STEP, step)
    time.monotonic_ns = lambda: steady_ns() + steps * step_ns
    sys.argv[:] = sys.argv[1:]
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
