import json

import numpy as np
import pytest

from fuzz.telemetry_readers import preamble, status_message
from protocol.summary.tables import PressFigures, Summary
from protocol.tactile import ElasticLayer
from protocol.wire.messages import ClockReply, Frame, Welcome, encode_control, encode_frame
from protocol.wire.stream import Channel, StreamDescription
from protocol.wire.telemetry import CONTROL, PlaybackStatus
from telepulse.recording.findings import RunFindings
from telepulse.recording.mcap_writer import as_json
from telepulse.telemetry.decoder import TelemetryDecoder
from tests.support.streams import synthetic
from tests.support.telemetry_publisher import MS, HandmadeTelemetry


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


def test_frames_before_the_first_status_are_those_of_its_channels() -> None:
    channels = tuple(Channel(name) for name in ("cun", "guan"))
    welcome = Welcome(1, 0, StreamDescription("pulse", MS, 100, channels, ElasticLayer()))
    telemetry, findings = HandmadeTelemetry(), RunFindings()
    entries = telemetry.receive((CONTROL, encode_control(welcome)), at_ns=0)
    for t_ns in range(8):
        reply = encode_control(ClockReply(1, t_ns, t_ns, t_ns))
        entries += telemetry.receive((CONTROL, reply), at_ns=t_ns)
    pulse_n = synthetic().take(6_000)[:, 0]
    for number, force_n in enumerate(np.split(pulse_n, 60)):
        first, values = 100 * number, np.stack([np.zeros(100), force_n], 1).astype("<f4")
        frame = encode_frame(Frame(1, first, first * MS, MS, values))
        entries += telemetry.receive((0, frame), at_ns=(first + 100) * MS)
    entries += telemetry.decoder.decode(*status_message("playing", playing("second", 1)))
    for entry in entries:
        findings.take(entry._replace(fields=json.loads(as_json(entry.fields))))
    (contactor,) = findings.contactors
    assert contactor.beats.figures().count > 4


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
