"""Run every test, with the coverage of the core; the arguments are pytest's.

First those that compute, two at a time. Then those in real time, three at a time: they mostly wait,
and computing beside them would disturb them.
"""

import subprocess
import sys

CORE = ("protocol", "pulse_sensors", "sensing_node", "display_node")
COVERAGE = [f"--cov={package}" for package in CORE]
COMPUTING = ("-m", "not realtime", *COVERAGE, "--cov-report=", "--cov-fail-under=0")
REAL_TIME = ("-m", "realtime", "--numprocesses=3", *COVERAGE, "--cov-append")
NO_TESTS_MATCHED = 5

if __name__ == "__main__":
    statuses = [
        subprocess.run(
            [sys.executable, "-m", "pytest", *part, *sys.argv[1:]], check=False
        ).returncode
        for part in (COMPUTING, REAL_TIME)
    ]
    matched = [status for status in statuses if status != NO_TESTS_MATCHED]
    sys.exit(max(matched, default=NO_TESTS_MATCHED))
