"""Run every test, with the coverage of the core; the arguments are pytest's.

Those in real time run three at a time: they mostly wait. Those that compute run beside them in the
time that is left, two at a time: the scheduler lets an idle process run only when no other one wants to.
With `-n0` one test runs at a time.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

TESTS = Path(__file__).parent
CORE = ("protocol", "pulse_sensors", "pulse_drives", "sensing_node", "display_node")
COMPUTING = ("accuracy", "commissioning", "compiled", "reports")
# Of these folders, what measures real processes.
MEASURING = ("commissioning/test_bench_command.py", "reports/test_cost_study.py")
SYSTEM = sorted({path.parent for path in TESTS.glob("system/*/test_*.py")})
REAL_TIME = [
    *(str(folder) for folder in SYSTEM if folder.name not in COMPUTING),
    *(str(TESTS / "system" / file) for file in MEASURING),
]
COMPUTED = [f"--ignore={path}" for path in REAL_TIME]
NO_TESTS_MATCHED = 5


def command(name: str, *options: str) -> list[str]:
    """Return the command of a part; its failures and its coverage are kept apart from the other's."""
    return [
        *(sys.executable, "-m", "pytest", f"--override-ini=cache_dir=.pytest_cache/{name}"),
        *(f"--cov={package}" for package in CORE),
        *("--cov-report=", "--cov-fail-under=0", *options, *sys.argv[1:]),
    ]


def environment(name: str) -> dict[str, str]:
    return os.environ | {"COVERAGE_FILE": f".coverage.{name}"}


def give_way() -> None:
    """Let this process and its children run only when no other one wants to."""
    if hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    else:
        os.nice(19)


def run() -> list[int]:
    """Run both parts; return their statuses."""
    real_time = command("real_time", *REAL_TIME, "--numprocesses=3")
    computing = command("computing", *COMPUTED)
    if "-n0" in sys.argv:
        return [
            subprocess.run(part, env=environment(name), check=False).returncode
            for name, part in (("real_time", real_time), ("computing", computing))
        ]
    with tempfile.TemporaryFile() as printed:
        beside = subprocess.Popen(
            computing,
            env=environment("computing"),
            stdout=printed,
            stderr=subprocess.STDOUT,
            preexec_fn=give_way,
        )
        first = subprocess.run(real_time, env=environment("real_time"), check=False).returncode
        second = beside.wait()
        printed.seek(0)
        sys.stdout.buffer.write(printed.read())
        sys.stdout.flush()
    return [first, second]


if __name__ == "__main__":
    statuses = run()
    if "--no-cov" not in sys.argv:
        coverage = (sys.executable, "-m", "coverage")
        subprocess.run([*coverage, "combine", "--quiet"], check=False)
        statuses.append(subprocess.run([*coverage, "report"], check=False).returncode)
    matched = [status for status in statuses if status != NO_TESTS_MATCHED]
    sys.exit(max(matched, default=NO_TESTS_MATCHED))
