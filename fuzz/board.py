"""`python -m fuzz board`: search for a script after which the finger's board breaks a rule.

Here the input is no bytes but commands, inputs and silences, which the sketch plays as compiled for
this machine (`tests/support/board_search.py`). It needs a C++ compiler, and not atheris.
"""

import secrets
import time
from concurrent.futures import ThreadPoolExecutor, wait
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event

from tests.support.board_search import BoardSearch, Finding, copies

# A hundred times the tests' search, and for at least ten minutes.
LEAST_MS = 1_000_000_000
LEAST_S = 600.0
# Some seconds.
ROUND_MS = 2_000_000
PROGRESS_S = 60.0


def search_board(seconds: float | None, jobs: int) -> int:
    """Search for a time, by default for LEAST_S and LEAST_MS of the board; return exit status.

    jobs: boards at once.
    """
    began_s, ended = time.monotonic(), Event()
    first_seed = secrets.randbits(48)
    passed_ms = [0] * jobs

    def goes_on() -> bool:
        passed_s = time.monotonic() - began_s
        if seconds is not None:
            return passed_s < seconds
        return passed_s < LEAST_S or sum(passed_ms) < LEAST_MS

    def work(number: int, search: BoardSearch) -> Finding | None:
        for seed in count(first_seed + number, jobs):
            if ended.is_set() or not goes_on():
                return None
            more_ms, finding = search.at_random(seed, ROUND_MS)
            passed_ms[number] += more_ms
            if finding is not None:
                ended.set()
                return finding
        raise AssertionError("seeds do not end")

    def progress() -> str:
        passed_s = time.monotonic() - began_s
        return f"board: {sum(passed_ms):,} ms of the board in {passed_s:.0f} s"

    with TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        works = [pool.submit(work, *each) for each in enumerate(copies(Path(folder), jobs))]
        try:
            while wait(works, PROGRESS_S).not_done:
                print(progress(), flush=True)
        finally:
            ended.set()
        findings = [finding for each in works if (finding := each.result()) is not None]
    for finding in findings:
        print(finding)
    verdict = "FAIL" if findings else "ok"
    print(f"{verdict}: {progress()}, from seed {first_seed} on, {len(findings)} findings")
    return 1 if findings else 0
