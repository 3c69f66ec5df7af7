"""Events from one status of a display to the next."""

from dataclasses import replace

from protocol.summary import Summary
from telepulse.record.events import Event, StatusWatch

STATUS_NS = 200_000_000


def test_what_goes_wrong_often_at_the_bench_is_one_event() -> None:
    watch = StatusWatch()
    events: list[Event] = []
    for status in range(5):
        # One wrong answer a status is usual, one a command is not; so are superseded commands.
        hardware = {"drive no answer": status, "drive wrong": 100 * status}
        hardware["drive superseded"] = 100 * status
        summary = replace(Summary(), hardware=hardware).to_dict()
        events += watch.take("playing", summary, status * STATUS_NS)
    texts = [event.text for event in events if event.name == "hardware"]
    assert texts == ["drive wrong: 100 within one status"]
