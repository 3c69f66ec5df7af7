from dataclasses import replace
from pathlib import Path

import pytest

from display_node.doctor import host as module
from display_node.doctor.host import Host, describe, preemption_of, read_host, stolen
from protocol.host.realtime_request import spans


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
