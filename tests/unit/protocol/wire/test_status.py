import msgpack
import pytest

from protocol.errors import WireError
from protocol.run_summary import Summary
from protocol.summary_tables import SampleCounts
from protocol.wire.telemetry import PlaybackStatus, pack_status, read_status

SUMMARY = Summary(samples=SampleCounts(sent=5))


def test_a_sensing_nodes_status_comes_through() -> None:
    status = read_status(pack_status("streaming", "pulse", SUMMARY, False, 2**62, displays=3))
    assert (status.state, status.stream, status.final) == ("streaming", "pulse", False)
    assert (status.session, status.displays) == (2**62, 3)
    assert status.summary == SUMMARY.to_dict()


def test_a_display_tells_what_it_plays() -> None:
    playing = PlaybackStatus(1, 0.5, -4.8e-6, "stack", 60_000_000)
    status = read_status(pack_status("playing", "pulse", SUMMARY, False, 7, playing=playing))
    assert status.playing == playing


@pytest.mark.parametrize(
    "more",
    [
        [1],
        [1, 2],
        [1, 2, 3],
        ["1", 2, None],
        [1, 2.0, None],
        [True, 1, None],
        [{}, [], None],
        [1, 2, [0, 1.0, -1.0, "stack"]],
        [1, 2, [0, 1.0, -1.0, 5, 60]],
        [1, 2, [0, float("nan"), -1.0, "stack", 60]],
        [1, 2, {"channel": 0}],
    ],
)
def test_what_is_no_session_or_no_count_is_refused(more: list[object]) -> None:
    with pytest.raises(WireError):
        read_status(msgpack.packb(["playing", "pulse", {}, False, *more]))
