"""A record of any format as a source: what is chosen from it, and what it becomes in newtons."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.config.scene import validate
from protocol.config.scene_file import find_scene
from protocol.errors import SceneError, SourceError
from protocol.wire.description import Channel
from sensing_node.files.formats import open_signals
from sensing_node.files.signal_choice import record_table
from sensing_node.scene import load_sensing
from sensing_node.sources.recorded import RecordedSource, RecordingScene
from tests.support.refusals import refusal_of
from tests.support.signal_files import pulse_and_ecg, wfdb_record

SIGNALS = pulse_and_ecg()


def source(path: Path, **keys: Any) -> RecordedSource:
    table, _ = record_table(path)
    scene = validate(table | keys, RecordingScene, "source")
    return RecordedSource(scene, Path())


def test_a_pressure_becomes_a_force_and_the_ecg_announces_it(tmp_path: Path) -> None:
    played = source(wfdb_record(tmp_path, SIGNALS))
    assert played.channels == (Channel("pulse"), Channel("announce", "mV"))
    assert played.period_ns == 4_000_000
    values = played.take(1000)
    np.testing.assert_allclose(values[:, 0], 7.5e-3 * SIGNALS["ABP"], atol=1e-4)
    np.testing.assert_allclose(values[:, 1], SIGNALS["II"], atol=1e-3)
    assert played.warnings == []


def test_other_units_are_scaled_by_their_median_beat(tmp_path: Path) -> None:
    beats = pulse_and_ecg(12.0)["ABP"] / 40
    beats[500] = 9
    path = wfdb_record(tmp_path, {"RESP": beats})
    force_n = source(path).take(3000)[:, 0]
    assert np.ptp(np.delete(force_n, 500)) == pytest.approx(0.3, rel=0.01)
    assert force_n.mean() == pytest.approx(0.3)
    force_n = source(path, peak_to_peak="0.1 N", preload="0.5 N").take(3000)[:, 0]
    assert np.ptp(np.delete(force_n, 500)) == pytest.approx(0.1, rel=0.01)
    assert force_n.mean() == pytest.approx(0.5)


def test_an_ecg_of_another_rate_sets_the_rate_of_both(tmp_path: Path) -> None:
    wfdb_record(tmp_path, {"ABP": SIGNALS["ABP"][::2]}, rate="125")
    wfdb_record(tmp_path, {"II": SIGNALS["II"]}, name="e")
    (tmp_path / "both.hea").write_text(
        "both 2 125\nrec.dat 16 100/mmHg 16 0 0 0 0 ABP\ne.dat 16x2 2000/mV 16 0 0 0 0 II\n",
        encoding="utf-8",
    )
    played = source(tmp_path / "both", repeat="once")
    assert played.period_ns == 4_000_000
    values = played.take(2000)
    assert len(values) == 1000
    np.testing.assert_allclose(values[:, 1], SIGNALS["II"], atol=1e-3)
    force_n = values[:, 0]
    np.testing.assert_allclose(force_n[::2], 7.5e-3 * SIGNALS["ABP"][::2], atol=1e-4)
    # The slower one is interpolated.
    np.testing.assert_allclose(force_n[1:-1:2], (force_n[:-2:2] + force_n[2::2]) / 2)


def test_a_table_states_its_rate_and_unit_by_its_titles(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    rows = "".join(f"{n * 4},{v:.2f},\n" for n, v in enumerate(SIGNALS["ABP"]))
    path.write_text(f"t [ms],ABP [mmHg],note\n{rows}", encoding="utf-8")
    table, text = record_table(path)
    assert "plays ABP (mmHg, 250 Hz), chosen by its pulse, 75 /min" in text
    played = source(path)
    assert played.period_ns == 4_000_000
    np.testing.assert_allclose(played.take(1000)[:, 0], 7.5e-3 * SIGNALS["ABP"], atol=1e-4)
    np.save(tmp_path / "a.npy", SIGNALS["ABP"])
    with pytest.raises(SourceError, match=r'states no rate; .* --rate "500 Hz" beside --source'):
        source(tmp_path / "a.npy")
    np.testing.assert_allclose(
        source(tmp_path / "a.npy", rate="250 Hz", unit="mmHg").take(1000)[:, 0],
        7.5e-3 * SIGNALS["ABP"],
    )
    np.savez(tmp_path / "a.npz", **{"rate_hz": 250.0, "ABP [mmHg]": SIGNALS["ABP"]})
    force_n = source(tmp_path / "a.npz").take(1000)
    np.testing.assert_allclose(force_n, played.take(2000)[1000:], atol=1e-4)
    assert table["column"] == 1


def test_a_record_replaces_the_source_of_a_scene(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path, scene = wfdb_record(tmp_path, SIGNALS), find_scene("radial")
    caplog.set_level("INFO")
    sensing = load_sensing(scene, {"source": str(path), "channel": "RESP", "rate": None})
    assert isinstance(sensing.source, RecordingScene)
    assert (sensing.stream, sensing.source.column, sensing.source.announce) == ("rec", 2, 0)
    assert "plays RESP (V, 250 Hz), chosen as asked for; its median beat" in caplog.text
    assert sensing.layer == load_sensing(scene).layer
    with pytest.raises(SourceError, match="no signal 'x'"):
        load_sensing(scene, {"source": str(path), "channel": "x"})
    with pytest.raises(SceneError, match="--preload is of a record; give the record by --source"):
        load_sensing(scene, {"source": None, "preload": "0.1 N"})
    changes = {"source": str(path), "preload": "1 V"}
    assert "preload" in refusal_of(SceneError, load_sensing, scene, changes)
    assert len(open_signals(path).signals) == 3
