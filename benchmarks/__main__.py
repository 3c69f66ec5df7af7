"""`python -m benchmarks [NAME ...]`: run all benchmarks, or the named ones."""

import importlib
import sys

NAMES = (
    "wire",
    "simulation",
    "core",
    "beats",
    "contactors",
    "compensation",
    "paths",
    "press_paths",
    "behind_routers",
    "peers",
    "keys",
    "clock",
    "drives",
    "drive_faults",
    "emulated_bench",
    "bench_faults",
    "sensors",
    "faults",
    "load",
    "realtime",
    "stalls",
    "jumps",
    "injected_faults",
    "injected_faults_live",
    "random_stalls",
    "recording",
    "analysis",
    "long_file",
    "metrics",
    "page",
    "calm",
)


def main() -> int:
    """Run the benchmarks named on the command line."""
    chosen = sys.argv[1:] or NAMES
    for name in chosen:
        if name not in NAMES:
            print(f"benchmarks: no benchmark {name!r}; known: {', '.join(NAMES)}", file=sys.stderr)
            return 2
        importlib.import_module(f"benchmarks.{name}").main()
    return 0


sys.exit(main())
