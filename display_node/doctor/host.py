"""Properties of a host that delay a real-time loop and that its owner can change; only read."""

import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import zmq

from protocol.host.linux import spans

CPU = Path("/sys/devices/system/cpu")
CGROUP = Path("/sys/fs/cgroup")
SLOW_WAKE_US = 100
UNKNOWN = "not reported"


@dataclass(frozen=True, slots=True)
class Host:
    """Properties of a host; None or empty where they could not be read.

    cpus: numbers of the processors that this process may use. isolated: those that the kernel gives
    to no process by itself. quota: number of processors whose whole time its control group allows.
    governors: how the processors choose their speed. idle_us: time to wake from the deepest sleep.
    """

    system: str
    cpus: list[int] = field(default_factory=list)
    isolated: str = ""
    quota: float | None = None
    governors: list[str] = field(default_factory=list)
    idle_us: int | None = None
    curve: bool = False


def read_host() -> Host:
    """Read the properties that this host reports."""
    idle = [_kernel_text(path) for path in CPU.glob("cpu0/cpuidle/state*/latency")]
    governors = {_kernel_text(path) for path in CPU.glob("cpu*/cpufreq/scaling_governor")}
    return Host(
        system=f"{platform.system()} {platform.release()} on {platform.machine()}",
        cpus=sorted(os.sched_getaffinity(0)) if sys.platform == "linux" else [],
        isolated=_kernel_text(CPU / "isolated"),
        quota=_quota(),
        governors=sorted(governors),
        idle_us=max((int(text) for text in idle if text.isdigit()), default=None),
        curve=bool(zmq.has("curve")),
    )


def describe(host: Host) -> list[tuple[str, str]]:
    """Return the host as rows of a table, each a name and a text."""
    cpus = spans(frozenset(host.cpus)) or "any"
    if host.quota is not None:
        cpus += f", for the time of {host.quota:g}"
    if host.isolated:
        cpus += f", isolated {host.isolated}"
    power = list(host.governors)
    if host.idle_us is not None:
        power.append(f"{host.idle_us} µs to wake from the deepest sleep")
    return [
        ("system", host.system),
        ("may run on", cpus),
        ("power", ", ".join(power) or UNKNOWN),
        ("encryption", "CURVE" if host.curve else "none"),
    ]


def advice_on(host: Host) -> Iterator[str]:
    """Yield advice on this host, the most effective first."""
    if host.quota is not None and host.quota < 2:
        yield (
            f"the control group stops this process when it has had {host.quota:g} processors'"
            " time: lift cpu.max (docker run without --cpus)"
        )
    if host.governors and host.governors != ["performance"]:
        yield (
            f"processors change their speed ({', '.join(host.governors)}):"
            " cpupower frequency-set -g performance"
        )
    if host.idle_us is not None and host.idle_us >= SLOW_WAKE_US:
        yield (
            f"a processor takes {host.idle_us} µs to wake from its deepest sleep:"
            " boot with processor.max_cstate=1, or cpupower idle-set -D 50"
        )
    if not host.curve:
        yield "this ZeroMQ cannot encrypt: install pyzmq's own wheel, or libsodium"


def stolen() -> tuple[int, int]:
    """Return the time that a hypervisor took away, and the total time, of all processors.

    Both are in the kernel's units since its start; zeros where the kernel does not count them.
    """
    line = _kernel_text(Path("/proc/stat")).partition("\n")[0].split()[1:9]
    return (int(line[7]), sum(map(int, line))) if len(line) == 8 else (0, 0)


def _quota() -> float | None:
    """Return the number of processors whose time this process's control group allows."""
    for line in _kernel_text(Path("/proc/self/cgroup")).splitlines():
        if line.startswith("0::"):
            limit = CGROUP / line.removeprefix("0::").strip("/") / "cpu.max"
            quota, _, period = _kernel_text(limit).partition(" ")
            if quota.isdigit() and period.isdigit():
                return int(quota) / int(period)
    return None


def _kernel_text(path: Path) -> str:
    """Return the text of a file of the kernel; empty where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
