"""Run every test, with the coverage of the core; the arguments are pytest's.

First those that compute, two at a time; whole runs without the coverage, which takes a fifth of
their time and adds nothing. Then those in real time, four at a time: they mostly wait, and
computing beside them would disturb them.
"""

import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parent
CORE = ("protocol", "pulse_sensors", "pulse_drives", "sensing_node", "display_node")
COVERAGE = [f"--cov={package}" for package in CORE]
COMPUTING = ("accuracy", "commissioning", "compiled", "reports")
SYSTEM = sorted({path.parent for path in TESTS.glob("system/*/test_*.py")})
REAL_TIME = [str(folder) for folder in SYSTEM if folder.name not in COMPUTING]
RUNS = [str(folder) for folder in SYSTEM if folder.name in COMPUTING]
PARTS = (
    (f"--ignore={TESTS / 'system'}", *COVERAGE, "--cov-report=", "--cov-fail-under=0"),
    tuple(RUNS),
    (*REAL_TIME, "--numprocesses=4", *COVERAGE, "--cov-append"),
)
NO_TESTS_MATCHED = 5

if __name__ == "__main__":
    statuses = [
        subprocess.run(
            [sys.executable, "-m", "pytest", *part, *sys.argv[1:]], check=False
        ).returncode
        for part in PARTS
    ]
    matched = [status for status in statuses if status != NO_TESTS_MATCHED]
    sys.exit(max(matched, default=NO_TESTS_MATCHED))
