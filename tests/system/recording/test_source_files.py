"""`simulate --source` with files of others, and texts in exports, as commands."""

import json
from pathlib import Path

import edfio
import numpy as np
from pyarrow import parquet

from tests.support.nodes import read_json, run
from tests.support.recordings import record
from tests.support.signal_files import pulse_and_ecg

MODULE = "telepulse"
ABP = pulse_and_ecg()["ABP"]


def test_the_advice_on_rate_and_preload_can_be_followed(tmp_path: Path) -> None:
    path, out = tmp_path / "a.npy", tmp_path / "out.json"
    np.save(path, ABP - ABP.mean())
    asked = ("simulate", "--source", str(path), "--seconds", "2")
    result = run(MODULE, *asked)
    assert result.returncode == 2
    assert '--rate "500 Hz" beside --source' in result.stderr
    result = run(MODULE, *asked, "--rate", "250 Hz", "--preload", "0.5 N", "--json", str(out))
    assert result.returncode == 0, result.stderr
    assert read_json(out)["samples"]["sent"] == 500
    np.savez(tmp_path / "b.npz", **{"force [N]": np.sin(np.arange(2000) / 30), "rate_hz": 250.0})
    asked = ("simulate", "--source", str(tmp_path / "b.npz"), "--seconds", "2")
    result = run(MODULE, *asked)
    assert 'set preload = "1 N" or more (beside --source: --preload)' in result.stderr
    assert run(MODULE, *asked, "--preload", "1 N").returncode == 0


def test_what_a_person_stated_is_in_every_export(tmp_path: Path) -> None:
    about = {"subject": "S01", "position": "cun", "side": "left"}
    path = tmp_path / "a.mcap"
    record(path, 2, about=about)
    for to in ("edf", "wfdb", "xdf", "csv", "parquet"):
        result = run(MODULE, "export", str(path), "--to", to, "--out", str(tmp_path / to))
        assert result.returncode == 0, result.stderr
        assert "texts" not in result.stdout
    edf = edfio.read_edf(tmp_path / "edf")
    assert edf.patient.code == "S01"
    assert edf.patient.additional == ("position=cun", "side=left")
    assert "# side: left" in (tmp_path / "wfdb.hea").read_text(encoding="utf-8")
    assert b"<key>side</key><value>left</value>" in (tmp_path / "xdf").read_bytes()
    for folder in ("csv", "parquet"):
        assert read_json(tmp_path / folder / "provenance.json")["about"] == about
    metadata = parquet.read_schema(tmp_path / "parquet" / "samples.parquet").metadata
    assert metadata is None or b"telepulse.about" not in metadata
    stored = parquet.ParquetFile(tmp_path / "parquet" / "samples.parquet").metadata.metadata
    assert json.loads(stored[b"telepulse.about"]) == about
