"""Parts of the perceived delay E: the sensing chain's group delay, the loop's horizon."""

import math
from typing import Literal

import pytest

from display_node.display import Display
from tests.support.sender import MS, Sender, display
from tests.support.streams import description

GROUP_DELAY_MS = 12
RUN_MS = 2000


def pulse_n(at_ms: float) -> float:
    return 0.3 + 0.1 * math.sin(2 * math.pi * 2 * at_ms * 1e-3)


def playing(under_test: Display, group_delay_ms: int = 0) -> list[tuple[float, float, float]]:
    """Play a pulse; return time and E in ms and felt force of each tick of the last second.

    A sample holds the pulse of group_delay_ms before it; 5 samples arrive every 5 ms.
    """
    sender = Sender(stream=description(group_delay_ns=group_delay_ms * MS, bytes_per_sample=8))
    felt = []
    for ms in range(RUN_MS):
        now_ns = ms * MS
        at = under_test.tick(now_ns)
        if ms >= RUN_MS - 1000:
            felt.append((float(ms), at.playout_delay_ns / MS, at.felt_n))
        sender.serve(under_test, now_ns)
        if ms % 5 == 0:
            forces_n = [pulse_n(t_ms - group_delay_ms) for t_ms in range(ms - 4, ms + 1)]
            under_test.on_frame(sender.frame_of(now_ns, forces_n), now_ns)
    return felt


@pytest.mark.parametrize("group_delay_ms", [0, GROUP_DELAY_MS])
@pytest.mark.parametrize("compensation_ns", [40 * MS, "auto"], ids=["40 ms", "auto"])
def test_the_felt_pulse_is_e_old_whatever_the_group_delay(
    compensation_ns: int | Literal["auto"], group_delay_ms: int
) -> None:
    under_test = display("bench", compensation_ns=compensation_ns)
    felt = playing(under_test, group_delay_ms)
    # The pulse of now − E is in the sample that was taken at now − E + 12 ms.
    for at_ms, delay_ms, felt_n in felt:
        assert felt_n == pytest.approx(pulse_n(at_ms - delay_ms), abs=0.7e-3)
    if compensation_ns != "auto":
        assert felt[-1][1] == pytest.approx(40, abs=0.01)
    # The display's own errors include the chain's delay.
    under_test.finish_scores()
    summary = under_test.summary()
    assert summary.force_rmse_n.aligned == pytest.approx(0.2e-3, abs=0.2e-3)
    assert summary.clock.offset_ms == pytest.approx(5000)
    assert summary.one_way_delay_ms.max == pytest.approx(0, abs=0.1)
    assert summary.samples.late == 0


def test_the_covered_delay_includes_the_group_delay_that_is_predicted() -> None:
    under_test = display("bench", compensation_ns=0)
    felt = playing(under_test, GROUP_DELAY_MS)
    summary = under_test.summary()
    # The newest sample is 0 to 5 ms old, and the pulse in it 12 ms more.
    assert summary.covered_delay_ms == pytest.approx(GROUP_DELAY_MS + 3, abs=0.6)
    assert summary.playout_delay_ms.mean == pytest.approx(0, abs=0.01)
    # The error of a straight line 17 ms ahead is at most (ωt)² / 2 of the amplitude, here 2 %.
    off_n = max(abs(felt_n - pulse_n(at_ms - delay_ms)) for at_ms, delay_ms, felt_n in felt)
    assert 1e-3 < off_n < 0.03 * 0.1 * 2
    assert (summary.samples.late or 0) > 1_500


@pytest.mark.parametrize(
    ("name", "group_delay_ms", "reach_ms"),
    # The delay of real_bench's shaper is 6.42 ms.
    [("bench", 0, 1), ("bench", GROUP_DELAY_MS, 1), ("paper", 0, 1), ("real_bench", 0, 2 + 6.42)],
)
def test_auto_covers_the_chains_delay_and_reserves_the_loops_reach(
    name: str, group_delay_ms: int, reach_ms: float
) -> None:
    under_test = display(name)
    delay_ms = playing(under_test, group_delay_ms)[-1][1]
    # Frames of 5 ms are the link's delay. One sample after the horizon's end is needed to
    # interpolate the last tick.
    assert under_test.receiver.link_delay.delay_ns == 5 * MS
    assert delay_ms == pytest.approx(5 + group_delay_ms + reach_ms + 1, abs=0.01)
    # Nothing is predicted, so the covered delay is E.
    summary = under_test.summary()
    assert summary.covered_delay_ms == pytest.approx(delay_ms, abs=0.01)
    assert summary.samples.late == 0


def test_a_received_horizon_needs_no_prediction() -> None:
    hold, linear = (playing(display("real_bench", predictor=name)) for name in ("hold", "linear"))
    assert hold == linear
