"""Run the tests of `make test` on other Pythons, processors, settings and versions.

Each variant runs in a fresh clone of HEAD. What fails runs again alone, as in CI. The status is 0
when no test failed twice.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from tests.machines.environments import ROOT, UnavailableError, environment, install, output
from tests.machines.variants import NOBODY, Variant, variants

PYTEST = ("-m", "pytest", "--quick", "--color=no")
AGAIN = ("-n0", "--last-failed")
LOGS = ROOT / "out" / "machines"
LEFT_OUT = ("PYTHONPATH", "PYTHONDONTWRITEBYTECODE", "VIRTUAL_ENV", "MAKEFLAGS", "MAKELEVEL")


def pytest_run(variant: Variant, kept: Path, checkout: Path, *again: str) -> Counter[str]:
    """Run the tests, with their output in a file; return the numbers of pytest's last line."""
    settings = {key: text for key, text in os.environ.items() if key not in LEFT_OUT}
    settings |= {"OPENBLAS_NUM_THREADS": "1", **variant.settings}
    command = (*variant.before, str(kept / "bin" / "python"), *PYTEST, *again)
    LOGS.mkdir(parents=True, exist_ok=True)
    log = LOGS / f"{variant.name}.log"
    with log.open("a" if again else "w", encoding="utf-8") as file:
        subprocess.run(command, cwd=checkout, env=settings, stdout=file, stderr=file, check=False)
    last = log.read_text(encoding="utf-8", errors="replace").strip().rpartition("\n")[2]
    counted: Counter[str] = Counter()
    for number, word in re.findall(r"(\d+) (passed|failed|skipped|error)", last):
        counted[word] += int(number)
    if not counted["passed"] + counted["failed"]:
        raise UnavailableError(f"no test ran: {last}; see {log.relative_to(ROOT)}")
    return counted


def run(variant: Variant) -> tuple[Counter[str], list[str]]:
    """Run one variant; return its counts, and a line for each test that failed twice."""
    with tempfile.TemporaryDirectory(prefix="telepulse-machines-") as folder:
        kept, checkout = (
            environment(variant.python, variant.versions),
            Path(folder, variant.checkout),
        )
        output("git", "clone", "--quiet", str(ROOT), str(checkout))
        install(kept, "--no-deps", "-e", str(checkout))
        if NOBODY in variant.before:
            Path(folder).chmod(0o755)
            output("chown", "-R", f"{NOBODY}:{NOBODY}", str(checkout))
        counted = pytest_run(variant, kept, checkout)
        failed = counted["failed"] + counted["error"]
        if not failed:
            return counted, []
        again = pytest_run(variant, kept, checkout, *AGAIN)
        text = (LOGS / f"{variant.name}.log").read_text(encoding="utf-8", errors="replace")
        lines = re.findall(
            r"^(?:FAILED|ERROR) (tests/.*)", text.rpartition(" short test summary ")[2], re.M
        )
        counted["passed"] += again["passed"]
        counted["failed"] = again["failed"] + again["error"]
        counted["alone"] = failed - counted["failed"]
        return counted, lines if counted["failed"] else []


def report(variant: Variant) -> bool:
    """Run a variant and print its line; return whether it failed."""
    print(f"{variant.name:<24} {variant.what:<52} ", end="", flush=True)
    begun = time.monotonic()
    try:
        counted, lines = run(variant)
    except UnavailableError as error:
        print(f"FAILED: {error}")
        return True
    seconds = time.monotonic() - begun
    alone = f" ({counted['alone']} of them alone)" if counted["alone"] else ""
    print(
        f"{counted['passed']:>5} passed{alone}, {counted['failed']} failed, "
        f"{counted['skipped']} skipped, {seconds:.0f} s",
        flush=True,
    )
    for line in lines:
        print(f"    {line}")
    return bool(counted["failed"])


def main() -> int:
    """Run the command; return its status."""
    parser = argparse.ArgumentParser(prog="python -m tests.machines", description=__doc__)
    parser.add_argument("variants", nargs="*", help="their names; all, unless given")
    parser.add_argument("--list", action="store_true", help="name the variants")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="start none after them")
    given = parser.parse_args()
    every = variants()
    unknown = set(given.variants) - {each.name for each in every}
    if unknown:
        parser.error(f"unknown: {', '.join(sorted(unknown))}; --list names the variants")
    chosen = [each for each in every if not given.variants or each.name in given.variants]
    failed, until = False, time.monotonic() + 60 * given.minutes
    for variant in chosen:
        if variant.missing or given.list:
            note = f"not here: {variant.missing}" if variant.missing else ""
            print(f"{variant.name:<24} {variant.what:<52} {note}".rstrip())
        elif time.monotonic() > until:
            print(f"{variant.name:<24} {variant.what:<52} not run: no time is left")
        else:
            failed |= report(variant)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
