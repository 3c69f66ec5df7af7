"""`python -m fuzz board`: search for a script after which the finger's board breaks a rule.

Here the input is no bytes but commands, inputs and silences, which the sketch plays as compiled for
this machine (`tests/support/board_search.py`). It needs a C++ compiler, and not atheris.
"""

import secrets
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
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


def search_board(seconds: float | None, jobs: int) -> int:
    """Search for a time, by default for LEAST_S and LEAST_MS of the board; return exit status.

    jobs: boards at once.
    """
    began_s, ended = time.monotonic(), Event()
    first_seed = secrets.randbits(48)

    def goes_on(passed_ms: int) -> bool:
        passed_s = time.monotonic() - began_s
        if seconds is not None:
            return passed_s < seconds
        return passed_s < LEAST_S or passed_ms * jobs < LEAST_MS

    def work(search: BoardSearch, seeds: Iterator[int]) -> tuple[int, Finding | None]:
        passed_ms = 0
        while goes_on(passed_ms) and not ended.is_set():
            more_ms, finding = search.at_random(next(seeds), ROUND_MS)
            passed_ms += more_ms
            if finding is not None:
                ended.set()
                return passed_ms, finding
        return passed_ms, None

    with TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        searches = copies(Path(folder), jobs)
        seeds = [count(first_seed + number, jobs) for number in range(jobs)]
        try:
            outcomes = list(pool.map(work, searches, seeds))
        finally:
            ended.set()
    elapsed_s = time.monotonic() - began_s
    board_ms = sum(passed_ms for passed_ms, _ in outcomes)
    findings = [finding for _, finding in outcomes if finding is not None]
    for finding in findings:
        print(finding)
    print(
        f"{'FAIL' if findings else 'ok'}: board: {board_ms:,} ms of the board in {elapsed_s:.0f} s"
        f" from seed {first_seed} on, {len(findings)} findings"
    )
    return 1 if findings else 0
