"""The streams of `telepulse record --lsl` as LabRecorder records them and pyxdf reads them."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from tests.support.lsl_loopback import lsl_on_loopback
from tests.support.nodes import RADIAL, free_address, process
from tests.support.waiting import PATIENCE_S

pyxdf = pytest.importorskip("pyxdf")
RECORDER = shutil.which("LabRecorderCLI")
RECORDED_S = 5.0
RESOLVE_S = 30.0


@pytest.mark.skipif(
    RECORDER is None, reason="needs LabRecorderCLI on the path; no registry has it built"
)
def test_pyxdf_reads_what_lab_recorder_wrote_of_our_outlet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pylsl = lsl_on_loopback(tmp_path, monkeypatch)
    address, telemetry, path = free_address(), free_address(), tmp_path / "pulse.xdf"
    display = ("--connect", address, "--telemetry", telemetry, "--no-screen")
    with (
        process("sensing_node.cli", str(RADIAL), "--bind", address, "--quiet"),
        process("display_node.cli", str(RADIAL), *display),
        process("telepulse", "record", telemetry, "--lsl"),
    ):
        names = [f"telepulse {part}" for part in ("wrist", "finger")]
        for name in names:
            assert pylsl.resolve_byprop("name", name, 1, RESOLVE_S), name
        command = [str(RECORDER), str(path), *(f"name='{name}'" for name in names)]
        with subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, encoding="utf-8"
        ) as recorder:
            with pytest.raises(subprocess.TimeoutExpired):
                recorder.wait(RECORDED_S)
            # Enter ends a recording.
            output, _ = recorder.communicate("\n", timeout=PATIENCE_S)
            assert recorder.returncode == 0, output
    streams, _ = pyxdf.load_xdf(str(path))
    wrist, finger = (
        next(one for one in streams if one["info"]["name"] == [name]) for name in names
    )
    assert wrist["info"]["type"] == ["Force"]
    (channels,) = wrist["info"]["desc"][0]["channels"]
    assert channels["channel"][0]["unit"] == ["N"]
    values, times_s = wrist["time_series"][:, 0], wrist["time_stamps"]
    assert len(values) > 1_000 * (RECORDED_S - 3)
    assert wrist["info"]["effective_srate"] == pytest.approx(1_000, rel=0.01)
    # A pulse of 0.3 N on a preload, at the same instants of the same clock as at the finger.
    assert 0.1 < np.ptp(values) < 1
    felt, felt_s = finger["time_series"], finger["time_stamps"]
    assert felt.shape[1] == 2
    assert times_s[0] < felt_s[-1]
    assert felt_s[0] < times_s[-1]
