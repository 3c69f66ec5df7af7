import json
from base64 import b64decode
from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from display_node.scoring.beat_statistics import pulse_alarm
from protocol.faults import Fault, FaultKind, Note, Part
from protocol.refusals import CAUSE_MEANINGS, Reason
from protocol.summary.fields import (
    BeatFigures,
    Clock,
    Compensation,
    Deadlines,
    ErrorWindow,
    Limited,
    Limits,
    Loop,
    SampleCounts,
    Summary,
)
from protocol.ticks import TickState
from protocol.wire.marks import MARK, Mark, pack_mark
from protocol.wire.messages import Hello, encode_control, encode_frame
from protocol.wire.telemetry import CONTROL
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import CLOCK, EVENT, FRAME, REFUSED, SCHEMAS, STREAM
from tests.support.streams import description
from tests.support.telemetry_publisher import (
    NOW_NS,
    SESSION,
    WALL_NS,
    WELCOME,
    HandmadeTelemetry,
    bye,
    clock_reply,
    numbered_frame,
)

FAULTS = [Fault(FaultKind.SILENT, Part.FILM, "it broke", 7)]
PLAIN = {
    "boolean": (bool,),
    "string": (str,),
    "number": (int, float),
    "integer": (int,),
}


def assert_fits(value: Any, schema: dict[str, Any], where: str) -> None:
    """Check a value against its schema. Counts under free names are numbers."""
    if "oneOf" in schema:
        assert value in [choice["const"] for choice in schema["oneOf"]], where
    elif schema["type"] == "array":
        assert type(value) is list, where
        for item in value:
            assert_fits(item, schema["items"], where)
    elif schema["type"] == "object":
        for name, inner in value.items():
            if schema["properties"]:
                assert_fits(inner, schema["properties"][name], f"{where}.{name}")
            else:
                assert type(inner) is int, where
    else:
        assert type(value) in PLAIN[schema["type"]], f"{where}: {value!r}"
        if "contentEncoding" in schema:
            b64decode(value, validate=True)


def events(entries: Iterable[Entry]) -> list[tuple[str, str]]:
    return [(e.fields["name"], e.fields["message"]) for e in entries if e.topic == EVENT]


def of(entries: Iterable[Entry], topic: str) -> list[Entry]:
    return [entry for entry in entries if entry.topic == topic]


def test_a_frame_is_an_entry_with_its_bytes_samples_and_arrival() -> None:
    frame = numbered_frame(3)
    entries = HandmadeTelemetry().receive((0, encode_frame(frame)))
    (entry,) = of(entries, FRAME)
    fields = entry.fields
    assert entry.t_ns == NOW_NS + WALL_NS
    assert fields["arrived_ns"] == NOW_NS
    assert b64decode(fields["data"]) == encode_frame(frame)
    assert np.array(fields["force_n"], "<f4").tobytes() == frame.values.tobytes()
    assert fields["newest_n"] == frame.values[-1, 0]
    assert (fields["first_sample"], fields["t_first_ns"]) == (frame.first_sample, frame.t_first_ns)


def test_stream_clock_and_end_of_the_stream_are_entries() -> None:
    entries = HandmadeTelemetry().receive(
        (CONTROL, WELCOME), (CONTROL, clock_reply(NOW_NS - 400_000, 7_000_000)), (CONTROL, bye(25))
    )
    (stream,) = of(entries, STREAM)
    assert stream.fields["session"] == SESSION
    assert stream.fields["layer"]["thickness_m"] == description().layer.thickness_m
    (clock,) = of(entries, CLOCK)
    assert clock.fields["round_trip_ms"] == pytest.approx(0.4)
    assert clock.fields["offset_ms"] == pytest.approx(6.8)
    assert [name for name, _ in events(entries)] == ["begin", "session", "end of stream"]


def test_a_refused_message_is_kept_with_its_cause() -> None:
    garbage = ((0, b"\xff\xfe"), (0, b""), (CONTROL, encode_control(Hello("display"))))
    refused = of(HandmadeTelemetry().receive(*garbage), REFUSED)
    assert [b64decode(entry.fields["data"]) for entry in refused] == [data for _, data in garbage]
    causes = [entry.fields["cause"] for entry in refused]
    assert causes == ["not_msgpack", "truncated", "unexpected"]


def test_ticks_have_unix_times_as_far_apart_as_they_were() -> None:
    telemetry = HandmadeTelemetry()
    # A later change of the wall clock has no effect.
    telemetry.receive()
    telemetry.ahead_ns -= 10**12
    telemetry.receive()
    entries = telemetry.ticks(
        TickState(NOW_NS + 1, 5, 6, 0.25, 0.125, True), TickState(NOW_NS + 1_000_001)
    )
    assert [entry.t_ns for entry in entries] == [WALL_NS + NOW_NS + 1, WALL_NS + NOW_NS + 1_000_001]
    named = {"now_ns": NOW_NS + 1, "instant_ns": 6, "target_n": 0.25, "felt_n": 0.125}
    assert entries[0].fields == {**named, "scored": True, "trusted": False}


CUT = Limits(force=Limited(1, 0.004, 0.1), slew=Limited(0, 0.0, 0.0))


def test_each_event_comes_once() -> None:
    telemetry = HandmadeTelemetry()
    telemetry.receive((CONTROL, WELCOME))
    entries = [
        *telemetry.status("playing"),
        *telemetry.status("playing", rejected={"session": 3}, clock=Clock(steps=1)),
        *telemetry.status("fault", rejected={"session": 9}, clock=Clock(steps=1), faults=FAULTS),
        *telemetry.status("fault", clock=Clock(steps=2), faults=FAULTS, limited=CUT, final=True),
    ]
    assert events(entries) == [
        ("state", "playing"),
        ("join", "the pulse is felt; samples sent before: 0"),
        ("clock step", "a clock has jumped; jumps so far: 1"),
        ("refused", f"3 session: {CAUSE_MEANINGS['session']}"),
        ("state", "fault, was playing for 0.0 s"),
        ("fault", f"film: it broke: {FAULTS[0].remedy}"),
        ("clock step", "a clock has jumped; jumps so far: 2"),
        ("limited", "force limit reached"),
        ("end", "the display has ended"),
    ]
    assert telemetry.decoder.ended


def test_the_events_of_several_contactors_have_their_names() -> None:
    telemetry = HandmadeTelemetry()
    telemetry.receive((CONTROL, WELCOME))
    doubtful = Summary(limited=CUT, beats=BeatFigures(quality=0.0, alarm=True))
    dirty = Summary(limited=CUT, hardware={"garbled": 30, "drive superseded": 90})
    entries = [
        *telemetry.status("playing", contactors={"cun": Summary(), "chi": Summary()}),
        *telemetry.status("playing", contactors={"cun": doubtful, "chi": Summary()}),
        *telemetry.status("playing", contactors={"cun": Summary(limited=CUT), "chi": dirty}),
    ]
    text = pulse_alarm({"quality": 0.0, "alarm": True})
    assert events(entries)[2:] == [
        ("pulse", f"cun: {text}"),
        ("limited", "cun: force limit reached"),
        ("pulse: cun", "over after 0.0 s"),
        ("limited", "chi: force limit reached"),
        ("hardware", "chi: garbled: 30 within one status"),
    ]


def test_a_lasting_condition_has_an_event_at_begin_and_end() -> None:
    telemetry = HandmadeTelemetry()
    telemetry.receive((CONTROL, WELCOME), (0, encode_frame(numbered_frame(0))))
    late = Loop(1000, 60, late=True, last_5s=Deadlines(0.012, 61.0))
    entries = []
    # Statuses of 20 s, five times a second; frames come again after 12 s.
    for number in range(1, 100):
        at_ns = NOW_NS + number * 200_000_000
        entries += telemetry.ticks(TickState(at_ns))
        if number >= 60:
            entries += telemetry.receive((0, encode_frame(numbered_frame(number))), at_ns=at_ns)
        state = "stale" if 10 <= number <= 60 else "playing"
        loop = late if 65 <= number < 90 else Loop(1000, 60, late=False)
        # A count that grows is no new event each time.
        notes = [Note(Part.FILM, f"{number} samples missing")]
        entries += telemetry.status(state, loop=loop, notes=notes)
    assert events(entries) == [
        ("state", "playing"),
        ("join", "the pulse is felt; samples sent before: 0"),
        ("film's sensor", "1 samples missing"),
        ("link cut", "no frame for 1.2 s"),
        ("state", "stale, was playing for 1.8 s"),
        ("link cut", "over after 12.0 s"),
        ("state", "playing, was stale for 10.2 s"),
        ("deadline misses", "1.2 % of the ticks of the last 5 s missed, longest gap 61 ms"),
        ("deadline misses", "over after 5.0 s"),
    ]


def test_published_messages_that_did_not_arrive_are_counted() -> None:
    telemetry = HandmadeTelemetry()
    telemetry.receive((CONTROL, WELCOME))
    telemetry.ticks(TickState())
    assert telemetry.decoder.missed == {}
    telemetry.capture.traces_published += 4
    telemetry.capture.statuses_published += 1
    for number in range(3):
        telemetry.capture.add(NOW_NS, 0, encode_frame(numbered_frame(number)))
    list(telemetry.capture.take(NOW_NS, NOW_NS))
    entries = telemetry.receive((0, encode_frame(numbered_frame(3))))
    assert telemetry.decoder.missed == {"traces": 4, "statuses": 1, "captured messages": 3}
    assert events(entries) == [
        ("missed", "the recorder missed 4 traces, 1 statuses, 3 captured messages")
    ]
    assert events(telemetry.receive()) == []


def test_messages_before_the_recorder_are_not_missed_and_another_run_begins_anew() -> None:
    telemetry = HandmadeTelemetry()
    telemetry.capture.traces_published = 1000
    assert telemetry.ticks(TickState()) == []
    assert events(telemetry.receive()) == [("begin", "the recording")]
    telemetry.restart(2, ahead_ns=WALL_NS + 5)
    entries = telemetry.receive((0, encode_frame(numbered_frame(0))))
    assert events(entries) == [("begin", "another run of the display")]
    assert of(entries, FRAME)[0].t_ns == NOW_NS + WALL_NS + 5
    assert telemetry.decoder.missed == {}


def test_every_message_fits_its_schema() -> None:
    telemetry = HandmadeTelemetry()
    entries = [
        *telemetry.receive((CONTROL, WELCOME), (0, encode_frame(numbered_frame(0))), (0, b"?")),
        *telemetry.receive((CONTROL, clock_reply(1, 2))),
        *telemetry.ticks(TickState(1, 2, 3, 0.5, 0.5, True, 0.01, True), TickState(now_ns=2)),
        *telemetry.status(
            "playing",
            samples=SampleCounts(5, 3, 1, 1, 0, 2),
            rejected={"session": 1},
            faults=FAULTS,
            notes=[Note(Part.FILM, "3 samples missing", "cun")],
            waiting_for=[Reason("nobody listens at tcp://a:1", "start it")],
        ),
        *telemetry.status("stale", compensation=Compensation(0.5)),
        *telemetry.status("ended", windows=[ErrorWindow(0.0, 1.0, 43.0, 2e-3, None)], final=True),
    ]
    seen = Counter(entry.topic for entry in entries)
    assert set(seen) == set(SCHEMAS)
    for topic, _, fields in entries:
        as_read = json.loads(json.dumps(fields, allow_nan=False))
        assert_fits(as_read, SCHEMAS[topic][1], topic)


def test_a_mark_is_an_event_at_its_instant_and_missing_ones_are_counted() -> None:
    telemetry = HandmadeTelemetry()
    telemetry.receive((CONTROL, WELCOME))
    decode = telemetry.decoder.decode
    (entry,) = decode(MARK, pack_mark(Mark(4, 9, NOW_NS - 5_000_000, "cuff on")))
    assert events([entry]) == [("mark", "cuff on")]
    assert entry.t_ns == NOW_NS - 5_000_000 + WALL_NS
    assert telemetry.decoder.last_mark == Mark(4, 9, NOW_NS - 5_000_000, "cuff on")
    assert not telemetry.decoder.missed
    decode(MARK, pack_mark(Mark(7, 9, NOW_NS, "cuff off")))
    assert telemetry.decoder.missed == {"marks": 2}
    assert decode(MARK, b"garbage") == []
    assert telemetry.decoder.missed == {"marks": 2, "unreadable messages": 1}
