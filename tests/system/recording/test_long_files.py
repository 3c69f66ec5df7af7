"""The memory that an honest long file takes, against its size."""

from pathlib import Path

import numpy as np

from tests.support.nodes import run_python

# Prints by how much opening and playing a second file raised the most memory, in kB.
PLAY = """
import sys
from pathlib import Path
from sensing_node.sources.choice import record_table
from sensing_node.sources.recorded import RecordedSource, RecordingScene
def most_kb():
    return int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
def play(path):
    source = RecordedSource(RecordingScene.model_validate(record_table(Path(path))[0]
                            | {"rate": "1 kHz"}), Path())
    return source.take(10_000)
play(sys.argv[1])
before_kb = most_kb()
play(sys.argv[2])
print(most_kb() - before_kb)
"""


def test_a_long_array_is_played_from_the_disk(tmp_path: Path) -> None:
    time_s = np.arange(12_000_000) / 1000
    values = np.sin(7 * time_s).astype(np.float32)
    np.save(tmp_path / "short.npy", values[:10_000])
    np.save(tmp_path / "long.npy", values)
    files = (str(tmp_path / name) for name in ("short.npy", "long.npy"))
    result = run_python("-c", PLAY, *files)
    assert result.returncode == 0, result.stderr
    # Its pages, once; a copy in 64 bits would be twice as much again.
    assert int(result.stdout) * 1000 < 1.5 * values.nbytes
