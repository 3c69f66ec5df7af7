"""Fuzz one target: `python -m fuzz.target NAME [FOLDER | FILE] [-libFuzzer_option=...]`.

FOLDER is its corpus, to which the target's seeds are added. A FILE's bytes are tried once, which
reproduces a crash.
"""

import importlib
import resource
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import atheris

from fuzz.msgpack_mutator import mutate

OURS = ("protocol", "pulse_sensors", "pulse_drives", "sensing_node", "display_node", "telepulse")
PACKAGES = [*OURS, "tomllib", "cobs", "cantools", "textparser", "canopen", "pytrinamic", "mcap"]
# Limits of one input of a few kB: memory used, and memory requested.
MOST_BYTES_AN_INPUT = 64 << 20
MOST_VIRTUAL_BYTES = 512 << 20
STATUS = Path("/proc/self/status")


def within_memory(try_one: Callable[[bytes], None]) -> Callable[[bytes], None]:
    """Return `try_one` with a MemoryError when one input raises the process' peak too far."""
    peak_bytes = _peak_bytes()

    def bounded(data: bytes) -> None:
        nonlocal peak_bytes
        try_one(data)
        before, peak_bytes = peak_bytes, _peak_bytes()
        grown = peak_bytes - before
        if grown > MOST_BYTES_AN_INPUT:
            raise MemoryError(f"{len(data)} bytes took {grown >> 20} MiB")

    return bounded


def _peak_bytes() -> int:
    # Not getrusage's peak, which a process inherits from the one that started it.
    (line,) = (line for line in STATUS.read_text("ascii").splitlines() if line[:6] == "VmHWM:")
    return int(line.split()[1]) << 10


def _limit_virtual_memory() -> None:
    """Make a huge allocation fail, even one of which no page is ever touched."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    limit = pages * resource.getpagesize() + MOST_VIRTUAL_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def main() -> None:
    """Fuzz the target that the command line names."""
    name, *arguments = sys.argv[1:]
    with atheris.instrument_imports(include=PACKAGES):
        target = importlib.import_module(f"fuzz.targets.{name}")
        # Lazy imports are instrumented as well, and cost no input time or memory.
        for seed in target.seeds():
            target.try_one(seed)
    warnings.simplefilter("error")
    for folder in filter(Path.is_dir, map(Path, arguments)):
        for number, seed in enumerate(target.seeds()):
            folder.joinpath(f"seed-{number}").write_bytes(seed)
    _limit_virtual_memory()
    mutators = {"custom_mutator": mutate} if getattr(target, "MSGPACK", False) else {}
    atheris.Setup([sys.argv[0], *arguments], within_memory(target.try_one), **mutators)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
