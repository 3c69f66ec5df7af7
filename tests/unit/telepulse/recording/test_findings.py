import json

import numpy as np
import pytest

from fuzz.telemetry_readers import preamble, status_message
from protocol.faults import Note, Part
from protocol.summary.fields import ErrorWindow, PressFigures, Summary
from protocol.tactile import ElasticLayer
from protocol.wire.description import Channel, StreamDescription
from protocol.wire.messages import ClockReply, Frame, Welcome, encode_control, encode_frame
from protocol.wire.telemetry import CONTROL, PlaybackStatus
from telepulse.columns import SessionColumns
from telepulse.recording.contents import RecordingContents
from telepulse.recording.findings import RunFindings
from telepulse.recording.mcap_writer import as_json
from telepulse.recording.report import in_short
from telepulse.telemetry.decoder import Entry, TelemetryDecoder
from telepulse.telemetry.schema import STATUS
from tests.support.given_faults import FILM_LOST
from tests.support.streams import synthetic
from tests.support.telemetry_publisher import MS, HandmadeTelemetry
from tests.unit.telepulse.recording.test_forces import pulse_session


def playing(name: str, channel: int) -> PlaybackStatus:
    return PlaybackStatus(name, channel, 1.0, -4.8e-6, "linear", 60 * MS)


def contents_of(entries: list[Entry]) -> RecordingContents:
    """Return the contents of entries, as they are read from a file."""
    contents = RecordingContents()
    for entry in entries:
        contents.take(entry._replace(fields=json.loads(as_json(entry.fields))))
    contents.finish()
    return contents


def test_contactors_keep_their_findings_where_a_further_run_has_others() -> None:
    decoder, first, second = TelemetryDecoder(), playing("cun", 0), playing("chi", 2)
    messages = [*preamble()[:-1], status_message("playing", first, second)]
    messages += [*preamble(run=2)[:-1], status_message("playing", second, playing("guan", 0))]
    findings = RunFindings(
        contents_of([entry for message in messages for entry in decoder.decode(*message)])
    )
    assert [each.name for each in findings.contactors] == ["cun", "chi", "guan"]
    assert list(findings.summary().contactors) == ["cun", "chi", "guan"]


def test_a_window_without_a_known_error_is_read_as_it_was_recorded() -> None:
    telemetry, window = HandmadeTelemetry(), ErrorWindow(0.0, 1.0, 43.0, 2e-3, None)
    entries = [*telemetry.receive(), *telemetry.status("ended", windows=[window], final=True)]
    summary = contents_of(entries).summary
    assert summary is not None
    assert summary.windows == [window]


def test_a_recording_whose_faults_are_texts_is_read() -> None:
    telemetry = HandmadeTelemetry()
    entries = [*telemetry.receive(), *telemetry.status("fault", faults=[FILM_LOST], final=True)]
    (status,) = (entry for entry in entries if entry.topic == STATUS)
    new = contents_of(entries)
    assert new.summary is not None
    assert new.summary.faults == [FILM_LOST]
    old = {key: value for key, value in status.fields["summary"].items() if key != "notes"}
    status.fields["summary"] = old | {
        "faults": ["drive: no answer", "film's sensor: 3 missing"],
        "finger": "withdrawn",
        "waiting_for": "samples",
    }
    findings = RunFindings(contents_of(entries))
    assert findings.contents.summary is not None
    assert findings.contents.summary.notes == [Note(Part.FILM, "3 missing")]
    assert list(in_short(findings))[-1].endswith("faults: drive: no answer.")


def test_frames_before_the_first_status_are_those_of_its_channels() -> None:
    channels = tuple(Channel(name) for name in ("cun", "guan"))
    welcome = Welcome(1, 0, StreamDescription("pulse", MS, 100, channels, ElasticLayer()))
    telemetry = HandmadeTelemetry()
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
    (contactor,) = RunFindings(contents_of(entries)).contactors
    assert contactor.channel == 1
    assert contactor.beats.figures().count > 4


def test_a_session_without_a_status_is_played_as_the_one_before_or_else_the_next() -> None:
    contents = RecordingContents()
    contents.sessions = [SessionColumns(number) for number in range(5)]
    for number, name in ((1, "cun"), (3, "chi")):
        contents.sessions[number].playing = {name: playing(name, 0)}
    contents.finish()
    names = [name for session in contents.sessions for name in session.playing]
    assert names == ["cun", "cun", "cun", "chi", "chi"]


def test_a_pressing_fingers_force_is_not_compared_with_the_wrists() -> None:
    contents = RecordingContents()
    contents.sessions = [pulse_session(3)]
    findings = RunFindings(contents)
    assert findings.summary().force_rmse_n.aligned == pytest.approx(1e-3)
    assert findings.summary().strain_rmse.aligned == pytest.approx(1e-3 * 4.8e-6)
    contents.summary = Summary(press=PressFigures(press_n=1.0))
    assert findings.summary().force_rmse_n.aligned is None


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["cun"], "The force RMSE is 1.000 mN aligned"),
        (["cun", "chi"], "The force RMSE at chi, the worst contactor, is 2.000 mN aligned"),
    ],
)
def test_in_short_has_the_force_rmse_of_the_worst_contactor(
    names: list[str], expected: str
) -> None:
    contents = RecordingContents()
    contents.sessions = [pulse_session(3, names=names)]
    (sentence,) = (text for text in in_short(RunFindings(contents)) if "RMSE" in text)
    assert sentence.startswith(expected)
