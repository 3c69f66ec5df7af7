import os
from pathlib import Path

from tests.support.live_display import MODULE
from tests.support.nodes import RADIAL, read_json, run_python
from tests.support.rights import needs_rights

QUICK = ("-m", MODULE, "--doctor", "--seconds", "0.4")


@needs_rights
def test_the_doctor_measures_ticks_with_each_setting_and_without(tmp_path: Path) -> None:
    path = tmp_path / "report.json"
    doctor = run_python(*QUICK, "--json", str(path), str(RADIAL))
    assert (doctor.returncode, doctor.stderr) == (0, "")
    report = read_json(path)
    assert report["refused"] == []
    assert {"slack", "lock", "fifo=40"} <= set(report["granted"])
    rows = {(row["with"], row["beside"]) for row in report["late_us"]}
    settings = {"bare", "together", *report["granted"]}
    assert rows == {(name, beside) for name in settings for beside in ("nothing", "load")}
    assert all(row["ticks"] > 0 for row in report["late_us"])
    assert report["verdict"]["status"] in ("ok", "warn", "fail")
    assert report["tick_ms"] == 2.0
    assert report["host"]["cpus"] == sorted(os.sched_getaffinity(0))
    assert f"{report['verdict']['status']}: {report['verdict']['reason']}" in doctor.stdout
    assert "fifo=40" in doctor.stdout
