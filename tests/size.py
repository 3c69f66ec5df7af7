"""Print the size of the product and of what proves it; end with status 1 beyond a limit."""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Name: its folders, and the most lines and files of Python in them.
LIMITS: dict[str, tuple[tuple[str, ...], int, int | None]] = {
    "product": (
        ("protocol", "pulse_sensors", "pulse_drives", "sensing_node", "display_node", "telepulse"),
        45_000,
        290,
    ),
    "tests and their support": (("tests",), 40_000, None),
    "benchmarks, soak and fuzz": (("benchmarks", "soak", "fuzz"), 11_000, None),
}


def measure(*folders: str) -> tuple[int, int]:
    """Return lines and files of Python in the folders."""
    files = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files), len(files)


def main() -> int:
    """Print a line for each limit; return the exit status."""
    status = 0
    for name, (folders, most_lines, most_files) in LIMITS.items():
        lines, files = measure(*folders)
        beyond = lines > most_lines or (most_files is not None and files > most_files)
        status |= beyond
        limit = f"{most_lines} lines" + (f" in {most_files} files" if most_files else "")
        verdict = "beyond the limit" if beyond else "within the limit"
        print(f"{name}: {lines} lines in {files} files; {verdict} of {limit}")
    return status


if __name__ == "__main__":
    sys.exit(main())
