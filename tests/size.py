"""Print the size of the product and of what proves it; end with status 1 beyond a limit."""

import sys
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]


class Room(NamedTuple):
    """A part of the tree with its own limits; files is None where only the lines count."""

    name: str
    patterns: tuple[str, ...]
    most_lines: int
    most_files: int | None = None


# A file counts in the first room that one of its patterns matches; a * matches folders too.
ROOMS = (
    Room(
        "class bench, with its tests",
        (
            "*stepdir*",
            "*class_bench*",
            "*drive_film*",
            "*/cli/*boards.py",
            "*/emulators/sketch.py",
            "tests/support/*avr*",
        ),
        2_500,
    ),
    Room(
        "product",
        (
            "protocol/*",
            "pulse_sensors/*",
            "pulse_drives/*",
            "sensing_node/*",
            "display_node/*",
            "telepulse/*",
        ),
        45_000,
        290,
    ),
    Room("tests and their support", ("tests/*",), 40_000),
    Room("benchmarks, soak and fuzz", ("benchmarks/*", "soak/*", "fuzz/*"), 11_000),
)


def files_by_room() -> dict[Room, list[Path]]:
    """Return the Python files of each room."""
    files: dict[Room, list[Path]] = {room: [] for room in ROOMS}
    for top in sorted(
        {pattern.split("/")[0] for room in ROOMS for pattern in room.patterns if pattern[0] != "*"}
    ):
        for path in (ROOT / top).rglob("*.py"):
            name = path.relative_to(ROOT).as_posix()
            room = next(
                room for room in ROOMS if any(fnmatch(name, pattern) for pattern in room.patterns)
            )
            files[room].append(path)
    return files


def main() -> int:
    """Print a line for each room; return the exit status."""
    status = 0
    for room, files in files_by_room().items():
        lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in files)
        beyond = lines > room.most_lines or (
            room.most_files is not None and len(files) > room.most_files
        )
        status |= beyond
        limit = f"{room.most_lines} lines" + (
            f" in {room.most_files} files" if room.most_files else ""
        )
        verdict = "beyond the limit" if beyond else "within the limit"
        print(f"{room.name}: {lines} lines in {len(files)} files; {verdict} of {limit}")
    return status


if __name__ == "__main__":
    sys.exit(main())
