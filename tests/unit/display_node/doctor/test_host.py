""" """

from dataclasses import replace
from pathlib import Path

import pytest

from display_node.doctor import host as module
from display_node.doctor.host import (
    BARE,
    IDLE,
    LOADED,
    TOGETHER,
    Host,
    HostFindings,
    HostVerdict,
    describe,
    judge,
    preemption_of,
    read_host,
    stolen,
)
from display_node.doctor.jitter import Ticks
from protocol.histogram import Histogram
from protocol.host.process import spans

GOOD_HOST = Host("Linux 6.18", "PREEMPT_RT", clocksource="tsc", curve=True)


def ticks(begun: int, missed: int, latest_us: float = 80.0) -> Ticks:
    late_us = Histogram(2.0, 5_000)
    for _ in range(begun - 1):
        late_us.add(40.0)
    late_us.add(latest_us)
    return Ticks(late_us, missed)


def findings(bare: Ticks, together: Ticks | None = None, **changes: object) -> HostFindings:
    found = {(BARE, IDLE): ticks(1000, 0), (BARE, LOADED): bare}
    if together is not None:
        found[TOGETHER, LOADED] = together
    option = None if together is None else "slack,fifo=40"
    return replace(
        HostFindings(1_000_000, found, option, [], 0.0),
        **changes,  # type: ignore[arg-type]
    )


def verdict(found: HostFindings, host: Host = GOOD_HOST) -> HostVerdict:
    return judge(host, found)


@pytest.mark.parametrize(
    ("missed", "status"), [(0, "ok"), (1, "ok"), (2, "look"), (10, "look"), (12, "fail")]
)
def test_the_share_of_ticks_missed_decides(missed: int, status: str) -> None:
    assert verdict(findings(ticks(1000 - missed, missed))).status == status


def test_a_gap_longer_than_a_drives_watchdog_fails_whatever_the_share() -> None:
    assert verdict(findings(ticks(100_000, 0, latest_us=50_000))).status == "ok"
    found = verdict(findings(ticks(100_000, 0, latest_us=50_001)))
    assert found.status == "fail"
    assert found.reason.endswith("longer than the watchdog of a drive (50 ms)")


def test_what_is_granted_counts_and_is_told_beside_bare() -> None:
    found = verdict(findings(ticks(900, 100), ticks(1000, 0, latest_us=350.0)))
    assert found.status == "ok"
    assert found.reason == (
        "beside a load, with --realtime slack,fifo=40, 0 of 1000 ticks were missed"
        " (bare 100 of 1000), the latest began 0.4 ms late"
    )
    bare = verdict(findings(ticks(900, 100)))
    assert bare.status == "fail"
    assert "with no measure, 100 of 1000" in bare.reason


def test_no_tick_at_all_is_a_failure() -> None:
    assert verdict(findings(Ticks())).status == "fail"


def test_a_good_host_gets_no_advice() -> None:
    assert verdict(findings(ticks(1000, 0))).advice == []


@pytest.mark.parametrize(
    ("host", "said"),
    [
        ({"quota": 0.5}, "0.5 processors' time"),
        ({"governors": ["powersave"]}, "frequency-set -g performance"),
        ({"idle_us": 200}, "200 µs to wake"),
        ({"clocksource": "hpet"}, "hpet, not tsc"),
        ({"curve": False}, "cannot encrypt"),
    ],
)
def test_what_slows_a_host_is_advised_on(host: dict[str, object], said: str) -> None:
    (line,) = verdict(findings(ticks(1000, 0)), replace(GOOD_HOST, **host)).advice  # type: ignore[arg-type]
    assert said in line


def test_what_is_well_is_not_advised_on() -> None:
    host = replace(GOOD_HOST, quota=4.0, governors=["performance"], idle_us=2)
    assert verdict(findings(ticks(1000, 0)), host).advice == []


def test_the_weightiest_advice_is_the_first() -> None:
    found = findings(ticks(1000, 0), refusals=["fifo: no"], stolen=0.031)
    advice = verdict(found, replace(GOOD_HOST, quota=1.0)).advice
    assert [line.split()[0] for line in advice] == ["the", "the", "fifo:"]
    assert "3.1% of the time" in advice[0]


@pytest.mark.parametrize(
    ("version", "said"),
    [
        ("#1 SMP PREEMPT_DYNAMIC Debian 6.1.90-1", "PREEMPT_DYNAMIC"),
        ("#1 SMP PREEMPT_RT Thu Jul 9", "PREEMPT_RT"),
        ("#28 SMP PREEMPT RT Wed Jun 18", "PREEMPT_RT"),
        ("#1 SMP PREEMPT Mon", "PREEMPT"),
        ("#1 SMP Mon", None),
        ("Darwin Kernel Version 23.1.0", None),
    ],
)
def test_a_kernel_says_how_preemptible_it_is(version: str, said: str | None) -> None:
    assert preemption_of(version) == said


def test_this_host_is_read_and_shown() -> None:
    host = read_host()
    rows = dict(describe(host))
    assert host.cpus
    assert host.limits.keys() == {"RTPRIO", "MEMLOCK", "NOFILE"}
    assert rows["may run on"].startswith(spans(frozenset(host.cpus)))
    assert all(rows.values())
    part, whole = stolen()
    assert 0 <= part <= whole


def test_a_host_that_says_nothing_is_read_and_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_text", lambda path: "")
    monkeypatch.setattr(module, "CPU", Path("/no such folder"))
    host = read_host()
    assert (host.quota, host.idle_us, host.clocksource, host.realtime_share) == (None,) * 4
    assert all(dict(describe(host)).values())
    assert stolen() == (0, 0)


def test_a_host_of_another_kind_is_shown() -> None:
    shown = dict(describe(Host("Windows 11 on ARM64", python="CPython 3.13", zeromq="4.3.5")))
    assert all(shown.values())


@pytest.mark.parametrize(
    ("files", "processors"),
    [
        ({"/proc/self/cgroup": "0::/a", "/sys/fs/cgroup/a/cpu.max": "50000 100000"}, 0.5),
        ({"/proc/self/cgroup": "0::/", "/sys/fs/cgroup/cpu.max": "max 100000"}, None),
        (
            {
                "/proc/self/cgroup": "2:cpu,cpuacct:/b\n1:name=systemd:/",
                "/sys/fs/cgroup/cpu/b/cpu.cfs_quota_us": "150000",
                "/sys/fs/cgroup/cpu/b/cpu.cfs_period_us": "100000",
            },
            1.5,
        ),
        (
            {
                "/proc/self/cgroup": "2:cpu:/b",
                "/sys/fs/cgroup/cpu/b/cpu.cfs_quota_us": "-1",
                "/sys/fs/cgroup/cpu/b/cpu.cfs_period_us": "100000",
            },
            None,
        ),
    ],
)
def test_a_control_groups_share_of_time_is_read(
    files: dict[str, str], processors: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_text", lambda path: files.get(str(path), ""))
    assert read_host().quota == processors


def test_an_extra_that_is_not_installed_is_named() -> None:
    wanted = ["numpy>=1", 'no-such-thing>=1; extra == "sensors"', 'pytest; extra == "drives"']
    found = module._missing([*wanted, "dask[distributed]; extra == 'cluster'"])
    assert found == {"sensors": ["no-such-thing"], "drives": []}
    shown = dict(describe(replace(read_host(), extras=found)))["extras"]
    assert shown == "sensors (without no-such-thing)"
