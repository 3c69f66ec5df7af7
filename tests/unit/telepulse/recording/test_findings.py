import pytest

from fuzz.telemetry_readers import MS, preamble, status_message
from protocol.press_figures import PressFigures
from protocol.run_summary import Summary
from protocol.wire.telemetry import PlaybackStatus
from telepulse.recording.findings import RunFindings
from telepulse.telemetry.decoder import TelemetryDecoder


def playing(name: str, channel: int) -> PlaybackStatus:
    return PlaybackStatus(name, channel, 1.0, -4.8e-6, "linear", 60 * MS)


def test_contactors_keep_their_findings_where_a_further_run_has_others() -> None:
    decoder, findings = TelemetryDecoder(), RunFindings()
    statuses = [[playing("cun", 0), playing("chi", 2)], [playing("chi", 2), playing("guan", 0)]]
    for message in preamble()[:-1] + [status_message("playing", *each) for each in statuses]:
        for entry in decoder.decode(*message):
            findings.take(entry)
    assert [each.name for each in findings.contactors] == ["cun", "chi", "guan"]
    assert [each.forces.alignment.channel for each in findings.contactors] == [0, 2, 0]
    assert list(findings.summary().contactors) == ["cun", "chi", "guan"]


def test_the_strain_is_that_of_the_recorded_status_or_unknown() -> None:
    findings = RunFindings()
    (contactor,) = findings.contactors
    alignment = contactor.forces.alignment
    alignment.errors.add_reference_force([0, 10 * MS, 20 * MS], [0.1, 0.3, 0.2])
    alignment.errors.add_output(10 * MS, 10 * MS, 0.4)
    status = playing("cun", 0)._asdict()
    # Older displays did not publish it.
    contactor.set_playback({key: status[key] for key in ("channel", "force_ratio")})
    findings.finish()
    assert findings.summary().force_rmse_n.aligned == pytest.approx(0.1)
    assert findings.summary().strain_rmse.aligned is None
    contactor.begin()
    contactor.set_playback(status)
    assert findings.summary().strain_rmse.aligned == pytest.approx(0.1 * 4.8e-6)


def test_a_pressing_fingers_force_is_not_compared_with_the_wrists() -> None:
    findings = RunFindings()
    errors = findings.contactors[0].forces.alignment.errors
    errors.add_reference_force([0, 10 * MS, 20 * MS], [0.1, 0.3, 0.2])
    errors.add_output(10 * MS, 10 * MS, 1.3)
    findings.finish()
    assert findings.summary().force_rmse_n.aligned is not None
    findings.display_summary = Summary(press=PressFigures(press_n=1.0))
    assert findings.summary().force_rmse_n.aligned is None
