"""Run every test; the arguments are pytest's.

First those that compute, two at a time. Then those in real time, three at a time: they mostly wait,
and computing beside them would disturb them. Last those that need both processors, one at a time.
COVERAGE=1 adds the coverage of the core: a fifth more time for those that compute.
"""

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parent
CORE = ("protocol", "pulse_sensors", "pulse_drives", "sensing_node", "display_node")
COVERED = [f"--cov={package}" for package in CORE] if os.environ.get("COVERAGE") else []
COMPUTING = (
    *("accuracy", "documentation", "benchmarks", "commissioning", "paper", "plugins"),
    *("python_api", "stability"),
)
SYSTEM = sorted({path.parent for path in TESTS.glob("system/*/test_*.py")})
# Three drives whose forces are to be in step to 2 ms; the demo, whose terminal shows a heart
# rate only while few ticks are missed.
ALONE = [TESTS / "system" / name for name in ("drives/test_several_drives.py", "demo")]
REAL_TIME = [path for path in SYSTEM if path.name not in COMPUTING and path not in ALONE]
OTHERS = [path for path in TESTS.iterdir() if path.is_dir() and path.name != "system"]
# Long files first, and each in its place: at the end both processes have work.
COMPUTE = [*(TESTS / "system" / name for name in COMPUTING), *sorted(OTHERS)]
FIRST = [*COVERED, "--cov-report=", "--cov-fail-under=0"] if COVERED else []
LAST = [*COVERED, "--cov-append"] if COVERED else []
PARTS = (
    ("--no-loadscope-reorder", *map(str, COMPUTE), *FIRST),
    (*map(str, REAL_TIME), *(f"--ignore={path}" for path in ALONE), "--numprocesses=3", *LAST),
    (*map(str, ALONE), "--numprocesses=0", *LAST),
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
