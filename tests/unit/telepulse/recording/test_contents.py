"""Contents of a recording: sessions that begin and end, and columns of numbers."""

import math

import pytest

from fuzz.telemetry_readers import AHEAD_NS
from protocol.wire.messages import Frame, Welcome, encode_control, encode_frame
from protocol.wire.telemetry import CONTROL
from telepulse.columns import Rows, SessionColumns, TickRow, join_ticks
from telepulse.recording.contents import Point, RecordingContents
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import EVENT
from tests.support.streams import description, synthetic
from tests.support.telemetry_publisher import MS, HandmadeTelemetry, clock_reply

BEGIN = {"level": 2, "name": "begin", "message": "another run of the display"}
TICK = TickRow(0, 0, 0, True, True, True, False)


def received(session: int, begin_ms: int, ahead_ns: int) -> list[Entry]:
    """Return the entries of half a second of a session."""
    telemetry = HandmadeTelemetry()
    welcome = encode_control(Welcome(session, 0, description()))
    entries = telemetry.receive((CONTROL, welcome), at_ns=begin_ms * MS)
    for at_ms in range(begin_ms, begin_ms + 500, 5):
        reply = clock_reply(at_ms * MS, ahead_ns, session=session)
        values = synthetic().take(5).astype("<f4")
        t_ns = (at_ms - 5) * MS + ahead_ns
        frame = encode_frame(Frame(session, at_ms - begin_ms, t_ns, MS, values))
        entries += telemetry.receive((CONTROL, reply), (0, frame), at_ns=at_ms * MS)
    return [entry for entry in entries if entry.topic != EVENT]


def test_a_session_begins_with_one_of_the_sensing_node_and_with_a_run_of_the_display() -> None:
    contents = RecordingContents()
    first, second = received(1, 1_000, AHEAD_NS), received(2, 2_000, 3 * AHEAD_NS)
    for entry in (*first, *second[:-50], Entry(EVENT, 1, BEGIN), *second[-50:]):
        contents.take(entry)
    held = [(each.number, len(each.frames)) for each in contents.sessions if len(each.frames)]
    assert [number for number, _ in held] == [1, 2, 2]
    assert held[2][1] == 25
    assert len(contents.streams) == 2
    assert contents.points["one_way_ms"]["value"][-1] == pytest.approx(1.0, abs=0.01)


def test_a_contactor_that_appears_later_has_gaps_before() -> None:
    session, other = SessionColumns(), SessionColumns()
    session.playing = dict.fromkeys(("cun", "chi"))
    session.add_tick(TICK, [(0.1, 0.2)])
    session.add_tick(TICK._replace(now_ns=5), [(0.3, 0.4), (0.5, 0.6)])
    target_n, felt_n = session.forces_n("chi")
    assert math.isnan(target_n[0])
    assert (target_n[1], felt_n[1]) == (0.5, 0.6)
    assert all(math.isnan(force_n) for force_n in session.forces_n("guan")[1])
    assert join_ticks([session, other, session], "now_ns").tolist() == [0, 5, 0, 5]


@pytest.mark.parametrize("row", [(1 << 63, 0.0), (0.5, 0.0), (1, "a"), (None, 1.0)])
def test_a_number_that_is_none_is_refused(row: tuple[object, object]) -> None:
    with pytest.raises(ValueError, match=r"argument|range|format|integer"):
        Rows(Point).add(row)
