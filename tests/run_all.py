"""Run every test, with the coverage of the core; the arguments are pytest's.

Those in real time run three at a time: they mostly wait. Those that compute run beside them in the
time that is left: the scheduler runs an idle process only when no other one wants to run. With
`-n0` one test runs at a time.
"""

import os
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

TESTS = Path(__file__).parent
SYSTEM = TESTS / "system"
CORE = ("protocol", "pulse_sensors", "pulse_drives", "sensing_node", "display_node")
COVERAGE = (*(f"--cov={package}" for package in CORE), "--cov-report=", "--cov-fail-under=0")
# Of the folders that compute, these measure real processes.
MEASURING = ("commissioning/test_bench_command.py", "reports/test_cost_study.py")
COMPUTING = [str(SYSTEM / name) for name in ("accuracy", "commissioning", "compiled", "reports")]
REAL_TIME = sorted({str(path.parent) for path in SYSTEM.glob("*/test_*.py")} - set(COMPUTING))
MEASURED = [str(SYSTEM / file) for file in MEASURING]
# The units cover the lines that computing would, in a third less time than with its coverage.
PARTS = {
    "real_time": (*REAL_TIME, *MEASURED, "--numprocesses=3", *COVERAGE),
    "units": (str(TESTS), f"--ignore={SYSTEM}", "--numprocesses=1", *COVERAGE),
    "computing": (*COMPUTING, *(f"--ignore={file}" for file in MEASURED), "--numprocesses=1"),
}
NO_TESTS_MATCHED = 5


def command(name: str) -> list[str]:
    """Return the command of a part; its failures are kept apart from those of the others."""
    kept = f"--override-ini=cache_dir=.pytest_cache/{name}"
    return [sys.executable, "-m", "pytest", kept, *PARTS[name], *sys.argv[1:]]


def environment(name: str) -> dict[str, str]:
    """Return the environment of a part, whose coverage is combined with that of the others."""
    return os.environ | {"COVERAGE_FILE": f".coverage.{name}"}


def give_way() -> None:
    """Let this process and its children run only when no other one wants to."""
    if hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    else:
        os.nice(19)


def run_in_turn() -> list[int]:
    """Run the parts one after another; return their statuses."""
    return [
        subprocess.run(command(name), env=environment(name), check=False).returncode
        for name in PARTS
    ]


def run_beside_each_other() -> list[int]:
    """Run the parts at once; return their statuses. What gave way is printed at the end."""
    first, *others = PARTS
    with ExitStack() as files:
        beside = []
        for name in others:
            output = files.enter_context(tempfile.TemporaryFile())
            process = subprocess.Popen(
                command(name),
                env=environment(name),
                stdout=output,
                stderr=subprocess.STDOUT,
                preexec_fn=give_way,
            )
            beside.append((process, output))
        run = subprocess.run(command(first), env=environment(first), check=False)
        statuses = [run.returncode]
        for process, output in beside:
            statuses.append(process.wait())
            output.seek(0)
            sys.stdout.flush()
            sys.stdout.buffer.write(output.read())
    return statuses


if __name__ == "__main__":
    statuses = run_in_turn() if "-n0" in sys.argv else run_beside_each_other()
    if "--no-cov" not in sys.argv:
        coverage = (sys.executable, "-m", "coverage")
        subprocess.run([*coverage, "combine", "--quiet"], check=False)
        statuses.append(subprocess.run([*coverage, "report"], check=False).returncode)
    matched = [status for status in statuses if status != NO_TESTS_MATCHED]
    sys.exit(max(matched, default=NO_TESTS_MATCHED))
