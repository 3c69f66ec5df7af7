import pytest

from display_node.doctor.host import Host
from display_node.doctor.jitter import (
    BARE,
    IDLE,
    LOADED,
    TOGETHER,
    HostFindings,
    HostVerdict,
    Ticks,
    judge,
)

GOOD_HOST = Host("Linux 6.18", curve=True)


def ticks(begun: int, missed: int, latest_us: float = 80.0) -> Ticks:
    found = Ticks(missed=missed)
    for late_us in (*[40.0] * (begun - 1), latest_us):
        found.late_us.add(late_us)
    return found


def verdict(
    bare: Ticks,
    together: Ticks | None = None,
    host: Host = GOOD_HOST,
    refusals: tuple[str, ...] = (),
    stolen_share: float = 0.0,
) -> HostVerdict:
    found = {(BARE, IDLE): ticks(1000, 0), (BARE, LOADED): bare}
    if together is not None:
        found[TOGETHER, LOADED] = together
    option = None if together is None else "slack,fifo=40"
    return judge(host, HostFindings(1_000_000, found, option, refusals, stolen_share))


@pytest.mark.parametrize(
    ("bare", "status"),
    [
        *((ticks(1000 - missed, missed), "ok") for missed in (0, 1)),
        *((ticks(1000 - missed, missed), "warn") for missed in (2, 10)),
        (ticks(988, 12), "fail"),
        (Ticks(), "fail"),
        # A gap longer than the watchdog of a drive fails whatever the share.
        (ticks(100_000, 0, latest_us=50_000), "ok"),
        (ticks(100_000, 0, latest_us=50_001), "fail"),
    ],
)
def test_the_share_of_ticks_missed_and_the_longest_gap_decide(bare: Ticks, status: str) -> None:
    found = verdict(bare)
    assert (found.status, found.advice) == (status, [])
    gap = bare.late_us.maximum == 50_001
    assert found.reason.endswith("longer than the watchdog of a drive (50 ms)") == gap
