import os
import re

from tests.support.nodes import run_python

NEEDS_NOTHING = {"UDP", "pyzmq", "decoded only", "telepulse", "pyzmq, CURVE", "telepulse, CURVE"}


def test_the_benchmark_times_the_messages_of_every_installed_peer_in_order() -> None:
    wide = os.environ | {"COLUMNS": "200"}
    ended = run_python("-m", "benchmarks", "peers", "--quick", env=wide, timeout=120)
    assert ended.returncode == 0, ended.stderr
    table = [re.split(r"\s{2,}", line.strip()) for line in ended.stdout.splitlines()]
    rows = {name: figures for name, *figures in table if len(figures) >= 5 and name != "peer"}
    assert set(rows) >= NEEDS_NOTHING
    for name, (p50_us, _, _, _, _, disordered, *_) in rows.items():
        assert float(p50_us) > 0, name
        assert disordered == "0", name
    for other in ("pyzmq", "pyzmq, CURVE"):
        assert re.search(rf"p50 \d+\.\d\d times that of {other}; the bar is 1\.25: ", ended.stdout)
