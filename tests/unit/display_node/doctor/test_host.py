from dataclasses import replace
from pathlib import Path

import pytest

from display_node.doctor import host as module
from display_node.doctor.host import Host, describe, read_host, stolen
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
from protocol.host.process import spans

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


def test_the_granted_settings_are_judged_and_compared_with_none() -> None:
    found = verdict(ticks(900, 100), ticks(1000, 0, latest_us=350.0))
    assert found.status == "ok"
    assert found.reason == (
        "beside a load, with --realtime slack,fifo=40, 0 of 1000 ticks were missed"
        " (bare 100 of 1000), the latest began 0.4 ms late"
    )
    bare = verdict(ticks(900, 100))
    assert bare.status == "fail"
    assert "without --realtime, 100 of 1000" in bare.reason


@pytest.mark.parametrize(
    ("changes", "advice"),
    [
        ({"quota": 0.5}, "0.5 processors' time"),
        ({"governors": ["powersave"]}, "frequency-set -g performance"),
        ({"idle_us": 200}, "200 µs to wake"),
        ({"curve": False}, "cannot encrypt"),
        ({"quota": 4.0, "governors": ["performance"], "idle_us": 2}, None),
    ],
)
def test_advice_names_the_properties_that_slow_a_host(
    changes: dict[str, object], advice: str | None
) -> None:
    host = replace(GOOD_HOST, **changes)  # type: ignore[arg-type]
    found = verdict(ticks(1000, 0), host=host).advice
    assert len(found) == (advice is not None)
    assert advice is None or advice in found[0]


def test_a_host_with_or_without_kernel_files_is_read_and_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    host = read_host()
    rows = dict(describe(host))
    assert host.cpus
    assert rows["may run on"].startswith(spans(frozenset(host.cpus)))
    assert all(rows.values())
    part, whole = stolen()
    assert 0 <= part <= whole
    monkeypatch.setattr(module, "_kernel_text", lambda path: "")
    monkeypatch.setattr(module, "CPU", Path("/no such folder"))
    host = read_host()
    assert (host.quota, host.idle_us) == (None, None)
    other = Host("Windows 11 on ARM64")
    assert all([*dict(describe(host)).values(), *dict(describe(other)).values()])
    assert stolen() == (0, 0)


@pytest.mark.parametrize(
    ("files", "processors"),
    [
        ({"/proc/self/cgroup": "0::/a", "/sys/fs/cgroup/a/cpu.max": "50000 100000"}, 0.5),
        ({"/proc/self/cgroup": "0::/", "/sys/fs/cgroup/cpu.max": "max 100000"}, None),
        ({"/proc/self/cgroup": "1:name=systemd:/"}, None),
    ],
)
def test_a_control_groups_share_of_time_is_read(
    files: dict[str, str], processors: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_kernel_text", lambda path: files.get(str(path), ""))
    assert read_host().quota == processors
